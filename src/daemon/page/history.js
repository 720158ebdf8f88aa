// The recorded runs: search, filters and pages over the daemon's list; details of a run; which runs are chosen.
"use strict";

const RUNS_PER_PAGE = 25;
// The list is loaded again after this time while files are not checked for damage, ms.
const UNREAD_PERIOD_MS = 5000;
// Places of the pages so far; the last one is shown.
let pagesAfter = [""], nextAfter = "", searchTimer = 0, searchNumber = 0, unreadTimer = 0;
// Chosen runs: id and what the list says about it.
const chosenRuns = new Map();
const make = (kind, properties, ...children) => {
  const element = Object.assign(document.createElement(kind), properties);
  element.append(...children);
  return element;
};
const FILTERS = { "find-text": "text", "find-specimen": "specimen", "find-operator": "operator", "find-profile": "profile",
  "find-since": "since", "find-until": "until", "find-result": "result" };

function runQuery() {
  const query = new URLSearchParams({ limit: RUNS_PER_PAGE });
  for (const [id, key] of Object.entries(FILTERS)) if ($(id).value.trim()) query.set(key, $(id).value.trim());
  const after = pagesAfter[pagesAfter.length - 1];
  if (after) query.set("after", after);
  return query;
}

// Loads the page of the list that is shown. An answer that a later one has overtaken is dropped.
async function loadRuns() {
  const number = ++searchNumber, query = runQuery();
  const { reply: runs, headers } = await askWithHeaders(`api/runs?${query}`);
  if (number !== searchNumber) return;
  nextAfter = headers.get("leafbench-next") || "";
  const total = Number(headers.get("leafbench-total")), unread = Number(headers.get("leafbench-unread"));
  const first = (pagesAfter.length - 1) * RUNS_PER_PAGE + 1, filtered = query.size > (query.has("after") ? 2 : 1);
  write("runs-count", !total ? (filtered ? "No run fits." : "No runs yet.") :
    `${first} to ${first + runs.length - 1} of ${total}${unread ? `; ${unread} files are not checked for damage yet` : ""}`);
  $("newer").disabled = pagesAfter.length < 2;
  $("older").disabled = !nextAfter;
  const open = $("runs").querySelector("[aria-expanded=true]"), focused = document.activeElement.id;
  $("runs").replaceChildren(...runs.map(runRow));
  if (open && $(open.id)) openRun($(open.id));
  if (focused.startsWith("run-") && $(focused)) $(focused).focus();
  clearTimeout(unreadTimer);
  if (unread && !open) unreadTimer = setTimeout(showRuns, UNREAD_PERIOD_MS);
}

const showRuns = () => loadRuns().catch(error => say(error.message));

function runRow(run) {
  const tr = make("tr");
  const cell = (content, kind) => tr.append(make("td", { className: kind || "" }, content));
  const box = make("input", { type: "checkbox", id: `run-box-${run.run_id}`, checked: chosenRuns.has(run.run_id) });
  box.setAttribute("aria-label", `Choose run ${run.run_id}`);
  box.addEventListener("change", () => {
    if (box.checked) chosenRuns.set(run.run_id, run); else chosenRuns.delete(run.run_id);
    showChosen();
  });
  cell(make("label", { className: "box" }, box), "choose");
  const started = new Date(run.started_utc);
  const opener = make("button", { className: "opener", id: `run-open-${run.run_id}`,
    textContent: isNaN(started) ? run.run_id : started.toLocaleString() });
  opener.setAttribute("aria-expanded", "false");
  opener.run = run;
  opener.addEventListener("click", () => openRun(opener));
  cell(opener);
  cell(run.profile);
  cell(run.specimen);
  cell(run.operator);
  const why = [run.problem, withoutWord(run.cause, run.ending)].filter(Boolean).join(" \u00b7 ");
  const ended = make("span", { textContent: run.ending });
  if (why) ended.append(make("small", { textContent: why }));
  cell(ended);
  cell(String(run.cycles_completed || ""), "number");
  cell(String(run.samples), "number");
  cell(String(run.lost), "number");
  cell(String(run.late), "number");
  return tr;
}

// Opens or closes the details below a row.
async function openRun(opener) {
  const row = opener.closest("tr"), open = opener.getAttribute("aria-expanded") === "true";
  if (open) {
    opener.setAttribute("aria-expanded", "false");
    if (row.nextSibling && row.nextSibling.className === "details") row.nextSibling.remove();
    return;
  }
  opener.setAttribute("aria-expanded", "true");
  const place = make("td", { colSpan: row.cells.length }, "Reading the run\u2026");
  row.after(make("tr", { className: "details" }, place));
  try {
    place.replaceChildren(...runDetails(opener.run, await ask(`api/runs/${encodeURIComponent(opener.run.run_id)}`)));
  } catch (error) {
    place.textContent = error.message;
  }
}

function runDetails(run, detail) {
  const header = detail.header, links = make("div", { className: "chips" });
  const button = (text, action, isOrder) => {
    const b = make("button", { textContent: text, disabled: !!isOrder && isWatching() });
    if (isOrder) b.dataset.order = "";
    b.addEventListener("click", async () => {
      say("");
      try { await action(); } catch (error) { say(error.message); }
    });
    links.append(b);
  };
  const link = (text, path) => links.append(make("a", { textContent: text, href: `api/runs/${run.run_id}/${path}` }));
  // The panel lies over the plots: it is brought into sight.
  button("Result", async () => { await openResult(run.run_id); $("result").scrollIntoView({ block: "center" }); $("result-close").focus(); });
  link("Certificate", "certificate");
  const whole = run.ending !== "damaged" && run.ending !== "incomplete";
  if (run.ending !== "open") {
    link(whole ? "CSV" : "CSV, what is left", whole ? "csv" : "csv?partial=1");
    if (whole && run.cycles_completed > 1) link("CSV, mean loop", "csv?mean_loop=true");
    if (whole) { link("MF4", "mf4"); link("Parquet", "parquet"); }
  }
  if (run.cycles_completed > 0 && (run.ending === "stopped" || run.ending === "aborted")) {
    button(`Continue after cycle ${run.cycles_completed}`, () => start({ profile: null, resume_run: run.run_id }), true);
  }
  if (run.started_utc && run.ending !== "open") button("Diagnose this run", () => askForDiagnosis([run.run_id]));
  const facts = make("dl", { className: "facts" });
  const fact = (name, value) => { if (value) facts.append(make("div", {}, make("dt", { textContent: name }), make("dd", { textContent: value }))); };
  fact("Run", run.run_id);
  fact("Started (UTC)", header.started_utc);
  fact("Twin", header.twin);
  fact("Planned", duration(header.duration_planned_s) + (header.cycles_planned ? `, ${header.cycles_planned} cycles` : ""));
  fact("Resumes", header.resumes_run);
  fact("Continues the file of", header.continues);
  fact("leafbench", header.program_version);
  const lines = [...header.remarks.map(sentence),
    ...detail.events.filter(e => e.kind !== "correction").map(e => `${number(e.time_s, 2)} s: ${e.text}`)];
  return [links, facts, make("ul", { className: "events" }, ...lines.map(line => make("li", { textContent: line })))];
}

function showChosen() {
  const count = chosenRuns.size;
  write("chosen", count ? `${count} chosen` : "");
  $("compare").disabled = count !== 2;
  $("diagnose").disabled = !count;
  $("choose-none").disabled = !count;
}

function turnPage(places) {
  pagesAfter = places;
  showRuns();
}

for (const id of Object.keys(FILTERS)) {
  $(id).addEventListener("input", () => {
    clearTimeout(searchTimer);
    searchTimer = setTimeout(() => turnPage([""]), 150);
  });
}
$("run-search").addEventListener("submit", event => { event.preventDefault(); turnPage([""]); });
$("find-clear").addEventListener("click", () => {
  for (const id of Object.keys(FILTERS)) $(id).value = "";
  turnPage([""]);
});
$("newer").addEventListener("click", () => turnPage(pagesAfter.slice(0, -1)));
$("older").addEventListener("click", () => turnPage([...pagesAfter, nextAfter]));
$("choose-none").addEventListener("click", () => {
  chosenRuns.clear();
  showChosen();
  showRuns();
});

// The arrow keys go from row to row.
$("runs").addEventListener("keydown", event => {
  const step = { ArrowDown: 1, ArrowUp: -1 }[event.key], here = event.target.closest("tr");
  if (!step || !here) return;
  const kind = event.target.type === "checkbox" ? "input[type=checkbox]" : ".opener";
  const all = [...$("runs").querySelectorAll(kind)], at = all.findIndex(e => e.closest("tr") === here);
  if (all[at + step]) { event.preventDefault(); all[at + step].focus(); }
});
showChosen();
