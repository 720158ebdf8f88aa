// Import of a table of another program: shows what is taken for what, lets one correct it, and writes a recording.
"use strict";

const TARGETS = [["", "not used"], ["time_s", "time"], ["displacement_mm", "displacement"], ["force_n", "force"], ["cycle", "cycle"]];
// The file, the choices of the person (null: as found by names and units), what the daemon made of them.
let importFile = null, importChoice = null, importSeen = null, importAsked = 0;

const decimalOf = text => Number(text.trim().replace(",", "."));
const importQuery = more => {
  const query = new URLSearchParams({ file: importFile.name, ...more });
  if (importChoice) {
    query.set("map", importChoice.filter(c => c.target).map(c => `#${c.index + 1}=${c.target}` +
      (c.factor.trim() === "" || c.target === "cycle" ? "" : `*${decimalOf(c.factor)}`)).join(","));
    for (const [key, target] of [["flip_force", "force_n"], ["flip_displacement", "displacement_mm"]])
      if (importChoice.some(c => c.target === target && c.flip)) query.set(key, "true");
  }
  const interval = $("import-interval").value;
  if (interval.trim()) query.set("dt", decimalOf(interval));
  if ($("import-decimal").value) query.set("decimal", $("import-decimal").value);
  return query;
};

$("import-file").addEventListener("change", () => {
  importFile = $("import-file").files[0] || null;
  importChoice = null;
  importSeen = null;
  $("import-interval").value = "";
  $("import-decimal").value = "";
  $("import-told").textContent = "";
  $("import-ask").hidden = true;
  $("import-view").hidden = true;
  if (!importFile) return;
  $("import-name").value = importFile.name.replace(/\.[^.]*$/, "").normalize("NFKD").replace(/[^A-Za-z0-9._-]+/g, "-").replace(/^[^A-Za-z0-9]+/, "").slice(0, 64) || "table";
  previewImport();
});

async function previewImport() {
  const mine = ++importAsked;
  try {
    const seen = await ask(`api/imports/preview?${importQuery({})}`, undefined, 0, { bytes: importFile });
    if (mine !== importAsked) return;
    importSeen = seen;
    // Until a person has chosen, the columns are as found by names and units.
    if (!importChoice || !importChoice.some(c => c.target)) {
      importChoice = choicesOf(seen);
      showColumns();
    }
    showPreview();
    $("import-told").textContent = "";
    $("import-view").hidden = false;
    drawImport();
  } catch (error) {
    if (mine !== importAsked) return;
    $("import-told").textContent = error.message;
    $("import-save").disabled = true;
  }
}

const choicesOf = seen => seen.columns.map((_, index) => {
  const found = seen.result && seen.result.mapped.find(m => m.index === index);
  return { index, target: found ? found.target : "", factor: found ? String(found.factor) : "", flip: false };
});

// One row for each column of the table: what it is taken for, with which factor and sign.
function showColumns() {
  $("import-map").replaceChildren(...importSeen.columns.map((name, i) => {
    const choice = importChoice[i];
    const changed = () => { factor.disabled = !choice.target || choice.target === "cycle"; flip.disabled = !["force_n", "displacement_mm"].includes(choice.target); previewImport(); };
    const target = element("select", {}, ...TARGETS.map(([value, textContent]) => element("option", { value, textContent })));
    target.value = choice.target;
    target.id = `import-target-${i}`;
    target.setAttribute("aria-label", `Column ${name} is taken for`);
    target.addEventListener("change", () => { choice.target = target.value; changed(); });
    const factor = element("input", { id: `import-factor-${i}`, inputMode: "decimal", autocomplete: "off", value: choice.factor, placeholder: "by its unit" });
    factor.setAttribute("aria-label", `Factor of column ${name} to s, mm or N`);
    factor.addEventListener("change", () => {
      const wrong = factor.value.trim() !== "" && !(isFinite(decimalOf(factor.value)) && decimalOf(factor.value) !== 0);
      factor.setAttribute("aria-invalid", String(wrong));
      if (!wrong) { choice.factor = factor.value; changed(); }
    });
    const flip = element("input", { id: `import-flip-${i}`, type: "checkbox" });
    flip.setAttribute("aria-label", `Turn the sign of column ${name}`);
    flip.addEventListener("change", () => { choice.flip = flip.checked; changed(); });
    factor.disabled = !choice.target;
    flip.disabled = !["force_n", "displacement_mm"].includes(choice.target);
    const cells = [name, importSeen.rows.slice(0, 3).map(r => r[i] || "").join("  "), target, factor, flip];
    return element("tr", {}, ...cells.map(content => element("td", {}, content)));
  }));
}

function showPreview() {
  const { result, problem } = importSeen;
  $("import-problem").textContent = problem ? `Not yet: ${problem}.` : "";
  $("import-save").disabled = !result;
  const reasons = result ? result.mapped.map(m => `${m.target}: column ${importSeen.columns[m.index]} * ${m.factor} (${m.reason})`) : [];
  $("import-facts").textContent = [
    `${importSeen.encoding}, ${importSeen.separator === "\t" ? "tabs" : `"${importSeen.separator}"`} between columns, first sample in row ${importSeen.first_row}`,
    ...(result ? [`decimal ${result.decimal}`, `${result.samples} samples over ${number(result.duration_s, 3)} s`] : []), ...reasons].join("; ") + ".";
  $("import-notes").replaceChildren(...(result ? result.notes : []).map(note => element("li", { textContent: sentence(note) })));
  $("import-heads").replaceChildren(element("tr", {}, ...["time in s", "displacement in mm", "force in N"].map(textContent => element("th", { textContent, className: "number" }))));
  $("import-rows").replaceChildren(...(result ? result.first : []).map(row =>
    element("tr", {}, ...row.map(value => element("td", { textContent: String(value), className: "number" })))));
}

const importPlot = new Plot($("import-loop"), "displacement in mm", "force in N", 0.001, 0.01);
function drawImport() {
  if (!importSeen || $("import-view").hidden) return;
  const { result } = importSeen;
  importPlot.x = importPlot.y = null;
  importPlot.draw([{ x: result ? result.loop_displacement_mm : [], y: result ? result.loop_force_n : [], colour: style("--measured") }],
    { silent: result ? "" : "no loop yet" });
}
window.addEventListener("resize", drawImport);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawImport);

for (const id of ["import-interval", "import-decimal"]) $(id).addEventListener("change", () => { if (importFile) previewImport(); });
$("import-save").addEventListener("click", () => saveImport(false));

async function saveImport(replace) {
  $("import-ask").hidden = true;
  try {
    const name = $("import-name").value.trim();
    const saved = await ask(`api/imports?${importQuery({ name, replace })}`, undefined, 0, { bytes: importFile });
    $("import-told").textContent = `Imported as ${saved.name}: ${saved.samples} samples in ${saved.csv}.`;
    await loadImports();
  } catch (error) {
    if (error.status === 409 && !replace) inquire("import-ask", `${error.message} Replace it?`, "Replace", () => saveImport(true));
    else $("import-told").textContent = error.message;
  }
}

async function loadImports() {
  const list = await ask("api/imports");
  $("imports-title").hidden = !list.length;
  $("imports").replaceChildren(...list.map(i => {
    const when = new Date(i.imported_utc);
    return element("li", {}, element("a", { href: `api/imports/${i.name}`, textContent: i.name }),
      ` ${i.samples} samples${i.imported_from ? `, from ${i.imported_from}` : ""}${isNaN(when) ? "" : `, ${when.toLocaleString()}`}; ${i.csv}`);
  }));
}
