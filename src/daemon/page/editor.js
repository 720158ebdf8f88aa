// The profile editor: one profile as form and text, checked while it is typed; saved, copied and deleted as a profile of the
// technician. The Run button takes what is saved.
"use strict";

const CHECK_AFTER_MS = 300, BUSY_MS = 700;
const NEW_PROFILE = `# Levels count from the tared zero; loading the spring is positive.
name = "my-test"
description = "One sentence for the list of profiles."
control = "displacement"

[[block]]
repeat = 1

[[block.segment]]
kind = "ramp"
to_mm = 5.0
duration_s = 5.0

[[block.segment]]
kind = "hold"
duration_s = 1.0

[[block.segment]]
kind = "ramp"
to_mm = 0.0
duration_s = 5.0
`;

// The profile in the editor: the name under which it is saved (null for a new one), where it comes from, the text as saved.
let edited = { name: null, origin: null, saved: "" };
let checkTimer = 0, checking = null, checked = null;

const isOpen = () => !$("editor").hidden;
const isChanged = () => isOpen() && source.value !== edited.saved;
// Why a profile may not run while the editor has changes of it.
const unsavedOf = name => isChanged() && edited.name === name ? `The editor has changes of ${name}: save them before you run it.` : "";

function openEditor(text, name, origin, file) {
  edited = { name, origin, saved: name ? text : "" };
  source.value = text;
  outline = null;
  formShape = "";
  errorPlace = null;
  $("editor").hidden = false;
  $("editor-ask").hidden = true;
  $("editor-told").textContent = "";
  showOrigin(file);
  showText();
  textChanged(0);
  $("editor").scrollIntoView({ block: "start" });
  source.focus({ preventScroll: true });
}

function showOrigin(file) {
  $("editor-title").textContent = edited.name ? `Profile ${edited.name}` : "New profile";
  $("editor-origin").textContent = !edited.name ? "not saved yet" :
    `${edited.origin === "own" ? "your own" : "shipped: Save makes a profile of your own"}, ${file}`;
  $("editor-delete").disabled = edited.origin !== "own";
}

async function editProfile(name) {
  const p = await ask(`api/profiles/${encodeURIComponent(name)}`);
  openEditor(p.text, p.name, p.origin, p.file);
}

// Asks before changes are lost.
function whenSaved(action) {
  if (isChanged()) inquire("editor-ask", "The changes are not saved. Discard them?", "Discard", action);
  else action();
}

const told = error => { $("editor-told").textContent = error.message; };
$("edit-profile").addEventListener("click", () => whenSaved(() => editProfile($("profile").value).catch(error => say(error.message))));
$("new-profile").addEventListener("click", () => whenSaved(() => openEditor(NEW_PROFILE, null, null, "")));
$("editor-close").addEventListener("click", () => whenSaved(() => {
  $("editor").hidden = true;
  if (checking) checking.abort();
  showPlan();
  $("edit-profile").focus();
}));

$("editor-save").addEventListener("click", () => save(false));
async function save(replace) {
  const text = source.value;
  $("editor-ask").hidden = true;
  try {
    const named = /^\s*name\s*=\s*["']([^"']*)["']/m.exec(text);
    const own = edited.origin === "own" && !!named && named[1] === edited.name;
    const saved = await ask("api/profiles", { text, replace: replace || own });
    edited = { name: saved.name, origin: "own", saved: text };
    showOrigin(saved.file);
    $("editor-told").textContent = `Saved as ${saved.name}.`;
    await loadProfiles(saved.name);
  } catch (error) {
    if (error.status === 409 && !replace) inquire("editor-ask", `${error.message} Replace it? A shipped file itself stays as it is.`, "Replace", () => save(true));
    else { if (error.place) showError(error); told(error); }
  }
}

$("editor-duplicate").addEventListener("click", () => {
  const there = outline && valueOf(outline.values, "name");
  if (!there) { $("editor-told").textContent = "Correct the text before you duplicate it."; return; }
  const name = unquoted(there.text).replace(/-copy(-\d+)?$/, "");
  const names = new Set(profiles.map(p => p.name));
  let copy = `${name}-copy`;
  for (let n = 2; names.has(copy); n++) copy = `${name}-copy-${n}`;
  openEditor(source.value.slice(0, there.from) + JSON.stringify(copy) + source.value.slice(there.to), null, null, "");
});

$("editor-delete").addEventListener("click", () => {
  const name = edited.name;
  inquire("editor-ask", `Delete your profile ${name}?`, "Delete", async () => {
    try {
      await ask(`api/profiles/${encodeURIComponent(name)}`, undefined, 0, { method: "DELETE" });
      $("editor").hidden = true;
      await loadProfiles();
      say(`The profile ${name} is deleted.`, true);
    } catch (error) { told(error); }
  });
});

// ---- the check while typing: outline, then plan; one at a time

source.addEventListener("input", () => { outline = null; showText(); textChanged(); });

function textChanged(afterMs = CHECK_AFTER_MS) {
  clearTimeout(checkTimer);
  // An answer about an older text would have wrong places.
  if (checking) checking.abort();
  checkTimer = setTimeout(check, afterMs);
  $("editor-save").classList.toggle("changed", isChanged());
  showPlan();
}

async function check() {
  if (checking) checking.abort();
  const mine = checking = new AbortController(), text = source.value;
  const one = async (path, body) => {
    const answer = await ask(path, body, 0, { signal: mine.signal });
    mine.signal.throwIfAborted();
    return answer;
  };
  try {
    outline = await one("api/outline", { text });
    $("editor-form").inert = false;
    showForm();
    // A press that waited for the outline has changed the text: it is checked anew.
    mine.signal.throwIfAborted();
    const plan = await one("api/plan", { profile: text, course: true });
    checked = plan;
    showError(null);
    showChecked(plan);
  } catch (error) {
    if (mine.signal.aborted) return;
    if (error.status === 503) { checkTimer = setTimeout(check, BUSY_MS); return; }
    checked = null;
    // Without an outline the form shows an older text.
    if (!outline) { $("editor-form").inert = true; waiting = null; }
    showError(error);
    showChecked(null);
  }
}

// Text of a margin in percent of its limit: where it is above 100 the value lies on the other side of zero.
const marginWords = m => m.margin_percent < 0 ? `exceeded by ${number(-m.margin_percent, 1)} % of the limit` :
  m.margin_percent > 100 ? "far: on the other side of zero" : `${number(m.margin_percent, 1)} % left`;

function showChecked(plan) {
  const words = $("editor-plan");
  words.classList.toggle("bad", !!plan && plan.trips.length > 0);
  if (!plan) { words.textContent = "Correct the text: then the prediction is shown here."; drawCourse(null); return; }
  const nearest = plan.margins.reduce((a, b) => a && a.margin_percent <= b.margin_percent ? a : b, null);
  words.textContent = planWords(plan) + (nearest ? ` Nearest limit: ${nearest.limit}, ${marginWords(nearest)}.` : "");
  drawCourse(plan.course);
}

const editorPlots = [new Plot($("editor-displacement"), "time in s", "", 0, 1), new Plot($("editor-force"), "time in s", "", 0, 50)];
let drawnCourse = null;

function drawCourse(course) {
  drawnCourse = course;
  const scale = status && status.plot || {};
  const isForce = outline ? outline.unit === "n" : false, t = course ? course.time_s : [];
  const commandLine = { x: t, y: course ? course.command : [], colour: style("--command"), width: 4 };
  const predicted = y => ({ x: t, y: course ? y : [], colour: style("--twin"), width: 2, dash: [7, 4] });
  const silent = course ? "" : "no prediction";
  const xRange = [0, t.length ? t[t.length - 1] : 1];
  editorPlots.forEach(plot => { plot.y = null; });
  editorPlots[0].draw([...(isForce ? [] : [commandLine]), predicted(course && course.displacement_mm)],
    { xRange, yLimits: [scale.displacement_min_mm, scale.displacement_max_mm], silent });
  editorPlots[1].draw([...(isForce ? [commandLine] : []), predicted(course && course.force_n)],
    { xRange, yLimits: [scale.force_min_n, scale.force_max_n], silent });
}
window.addEventListener("resize", () => { if (isOpen()) drawCourse(drawnCourse); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { if (isOpen()) drawCourse(drawnCourse); });
