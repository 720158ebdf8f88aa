// The technician's page: status and samples come over one WebSocket, requests go over HTTP. The daemon has the whole state,
// so the page can be closed and opened at any time.
"use strict";

// ---- buttons and keys

function press(id, action) {
  $(id).addEventListener("click", async () => {
    say("");
    try { await action(); } catch (error) { say(error.message); }
  });
}

async function stop(reason) {
  jogEnd();
  say("");
  try { await ask("api/stop", { reason }); } catch (error) { say(`Stop was not taken: ${error.message}`); }
}

$("stop").addEventListener("click", () => stop("stopped by the Stop button of the page"));

// Escape stops always, Space where nobody types or chooses. A button that has the focus is pressed by Enter.
const isField = element => !!element && element.matches("input, select, textarea");
document.addEventListener("keydown", event => {
  const stops = event.key === "Escape" || (event.key === " " && !isField(event.target));
  if (!stops) return;
  event.preventDefault();
  if (!event.repeat) stop(`stopped by key ${event.key === " " ? "Space" : "Esc"} on the page`);
}, true);
document.addEventListener("keyup", event => {
  if (event.key === " " && !isField(event.target)) event.preventDefault();
}, true);

press("hold", () => ask("api/hold", {}));
press("resume", () => ask("api/resume", {}));
press("reset", () => ask("api/reset", {}));
press("zero", () => ask("api/zero", {}));
press("tare", async () => {
  const t = await ask("api/tare", {});
  say(`New tare: force ${number(t.force_old_n, 1)} N \u2192 ${number(t.force_new_n, 1)} N, ` +
    `displacement ${number(t.displacement_old_mm, 3)} mm \u2192 ${number(t.displacement_new_mm, 3)} mm.`, true);
});
press("run", () => start({ profile: chosenProfile() }));

async function start(request) {
  $("run").disabled = true;
  try {
    await ask("api/run", { ...request, specimen: request.resume_run ? null : $("specimen").value || null,
      operator: $("operator").value || null, override_by: $("override").value || null });
    // The next start needs the name again.
    $("override").value = "";
  } finally {
    show();
  }
}

// ---- profiles and their plan

// Texts of profiles that are in no file of the daemon, by their value in the list.
const offered = new Map();
const chosenProfile = () => offered.has($("profile").value) ? offered.get($("profile").value).text : $("profile").value;

// Puts a profile into the list, chooses it and shows its plan.
function offerProfile(value, name, text) {
  offered.set(value, { name, text });
  showOffered();
  $("profile").value = value;
  plan();
}

function showOffered() {
  for (const [value, { name }] of offered) {
    if (![...$("profile").options].some(option => option.value === value)) $("profile").add(new Option(name, value));
  }
}

let profiles = [];
// A check that had to wait for another one, or for the start of a run, is asked for again after this time, ms.
const PLAN_AGAIN_MS = 2000;

// The list shows where a profile comes from.
async function loadProfiles(chosen) {
  profiles = await ask("api/profiles");
  const option = p => Object.assign(document.createElement("option"), {
    value: p.name, textContent: [p.name, p.problem && "(cannot be used)", p.replaces_shipped && "(in place of the shipped one)"]
      .filter(Boolean).join(" "), title: `${p.problem || p.description}\n${p.file}` });
  const group = (label, origin) => {
    const list = Object.assign(document.createElement("optgroup"), { label });
    list.append(...profiles.filter(p => p.origin === origin).map(option));
    return list;
  };
  $("profile").replaceChildren(...[group("Your profiles", "own"), group("Shipped profiles", "shipped")].filter(g => g.children.length));
  showOffered();
  const wanted = chosen || localStorage.getItem("profile");
  const first = [wanted, "static-ramp"].find(name => offered.has(name) || profiles.some(p => p.name === name && !p.problem));
  if (first) $("profile").value = first;
  plan();
}

async function plan() {
  const name = $("profile").value;
  if (!name) return;
  localStorage.setItem("profile", name);
  planned = { name, text: "", refused: false, limits: [] };
  try {
    const p = await ask("api/plan", { profile: chosenProfile() });
    if ($("profile").value !== name) return;
    planned = { name, text: planWords(p), refused: p.trips.length > 0, limits: p.accept || [] };
  } catch (error) {
    // A profile that cannot be used; another answer says nothing about the profile.
    planned = { name, text: error.message, refused: error.status === 422, limits: [] };
    if (error.status === 503) setTimeout(() => { if ($("profile").value === name) plan(); }, PLAN_AGAIN_MS);
  }
  showPlan();
}

// The prediction of the chosen profile, and whether it forbids a run.
let planned = { name: "", text: "", refused: false, limits: [] };

function planWords(p) {
  return p.trips.length > 0 ? "Cannot run: " + p.trips.join("; ") + "." :
    `${duration(p.duration_s)}. Predicted: ${number(p.force_max_n, 0)} N peak, ${number(p.displacement_min_mm, 1)} to ` +
    `${number(p.displacement_max_mm, 1)} mm, ${number(p.velocity_max_mm_s, 0)} mm/s` + (p.cycles ? `, ${p.cycles} cycles.` : ".");
}

// Why the chosen profile may not run now; empty if it may.
function runRefusal() {
  const unsaved = unsavedOf($("profile").value);
  return unsaved || (planned.refused ? planned.text : "");
}

function showPlan() {
  const refusal = runRefusal();
  $("plan").classList.toggle("bad", !!refusal);
  write("plan", refusal || planned.text);
  show();
}
$("profile").addEventListener("change", plan);
for (const id of ["specimen", "operator"]) {
  $(id).value = localStorage.getItem(id) || "";
  // At each letter: a page that is loaded again while somebody writes forgets nothing.
  $(id).addEventListener("input", () => localStorage.setItem(id, $(id).value));
}

// ---- status

// Writes a text only if it changes, so that a screen reader says it once.
function write(id, text) { if ($(id).textContent !== text) $(id).textContent = text; }

function show() {
  const rig = status && status.rig, phase = rig ? rig.phase : "offline";
  const [name, detail, clear] = phaseWords(status, everConnected);
  $("lamp").dataset.phase = name === JOG_KEEPS[0] ? "held" : phase;
  write("state", name);
  write("state-detail", detail);
  $("clear").hidden = !clear;
  const left = rig ? rig.hold_left_s : null;
  write("hold-left", left === null || left === undefined ? "" : `unloads in ${Math.ceil(left)} s`);
  write("force", number(rig && rig.force_n, 1));
  write("displacement", number(rig && rig.displacement_mm, 3));
  showPeaks();
  showCommander();
  allowButtons(rig, phase);
  showRun(rig);
  followResult();
  followRunLimits();
  showLimits();
  showWarnings();
  showTwin();
  if (!status) { write("footer", ""); return; }
  write("band", `noise, \u00b1${number(3 * status.plot.noise_n, 1)} N; ${isPredicted(limitsNow().profile) ? "predicted band" : "limits of the profile"}`);
  write("footer", [
    `leafbench ${status.version}, bench ${status.bench}, link ${status.link}${status.link_open ? "" : " (closed)"}, ` +
    `runs in ${status.data_folder}`,
    `largest delay of the control loop ${(status.control_loop.worst_lateness_us / 1000).toFixed(1)} ms`].join(" \u00b7 "));
}

// Stop is never disabled. A button that is held to move is not taken away while it is held.
function allowButtons(rig, phase) {
  const preparing = !!(status && status.preparing);
  const allow = (id, ...phases) => { $(id).disabled = isWatching() || !phases.includes(phase); };
  const ready = preparing ? [] : ["ready"];
  allow("hold", "running");
  allow("resume", "held");
  allow("reset", "interlocked");
  allow("tare", "ready", "interlocked");
  allow("zero", ...ready);
  allow("run", ...(runRefusal() ? [] : ready));
  const jogs = rig && rig.motion === "jog" ? ["arming", "running"] : [];
  allow("jog-up", ...ready, ...jogs);
  allow("jog-down", ...ready, ...jogs);
  if (!status) jogEnd();
}

function showRun(rig) {
  const run = status && status.run, live = rig && rig.run_id;
  if (live) {
    const total = rig.elapsed_s + rig.remaining_s;
    write("run-name", rig.profile);
    write("run-cycles", rig.cycles_total ? `cycle ${rig.cycles_completed} of ${rig.cycles_total}` : "");
    write("run-remaining", `${duration(rig.remaining_s)} left`);
    write("run-cause", "");
    $("progress").value = total > 0 ? rig.elapsed_s / total : 0;
  } else if (run && run.ending) {
    write("run-name", `${run.profile}: ${run.ending}`);
    write("run-cycles", `${run.samples} samples, ${run.lost} lost, ${run.late} late`);
    write("run-remaining", "");
    write("run-cause", sentence(withoutWord(run.cause, run.ending)));
    $("progress").value = run.ending === "completed" ? 1 : $("progress").value;
  }
  const counters = rig && rig.counters;
  write("counts", !counters ? "" : `Since the start of the daemon: ${counters.samples} samples, ${counters.lost} lost, ` +
    `${counters.late} late, ${counters.flagged} without a valid reading, ${counters.frames_refused} frames refused.`);
  const mismatch = (run && run.model_mismatch) || "";
  write("mismatch", mismatch);
  $("mismatch").hidden = !mismatch;
}

// What is wrong with this computer or the bench, one line each.
function showWarnings() {
  const run = status && status.run;
  const lines = status ? [
    ...(run && run.disk_problem ? [`Disk: ${run.disk_problem}`] : []), ...status.warnings, ...status.degraded].map(sentence) : [];
  const list = $("warnings");
  if (list.dataset.lines === lines.join("\n")) return;
  list.dataset.lines = lines.join("\n");
  list.replaceChildren(...lines.map(line => Object.assign(document.createElement("li"), { textContent: line })));
}

// ---- connection

// Status comes 10 times a second; without it for this long nothing on the page is live, ms.
const SILENT_MS = 2000;
let heardAt = 0;

// Without a session the daemon shows the page that signs in.
async function signInIfNeeded() {
  const answer = await fetch("api/status").catch(() => null);
  if (answer && (answer.status === 401 || answer.status === 429)) location.reload();
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const socket = new WebSocket(`${scheme}://${location.host}/api/live?caller=${callerId}`);
  socket.onopen = () => {
    everConnected = true;
    loadProfiles().catch(error => say(error.message));
    showRuns();
    showDiagnoses();
    loadImports().catch(error => say(error.message));
  };
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    if (message.type === "samples") { take(message); return; }
    heardAt = performance.now();
    const before = status && status.run && status.run.state;
    status = message.status;
    if (before !== (status.run && status.run.state)) showRuns();
    show();
  };
  const lose = () => { status = null; samplesAt = -Infinity; forgetStale(); show(); };
  socket.onclose = () => { lose(); signInIfNeeded(); setTimeout(connect, 1000); };
  // A connection that is open and silent is no connection.
  const watch = setInterval(() => {
    if (socket.readyState === WebSocket.CLOSED) clearInterval(watch);
    else if (status && performance.now() - heardAt > SILENT_MS) { lose(); socket.close(); }
  }, 500);
}

