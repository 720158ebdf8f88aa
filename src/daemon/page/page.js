// The technician's page: status and samples come over one WebSocket, requests go over HTTP. The daemon has the whole state,
// so the page can be closed and opened at any time.
"use strict";

const $ = id => document.getElementById(id);
const PHASES = {
  connecting: ["No rig", "The rig does not answer. Check its power and the link."],
  ready: ["Ready", "The rig is unloaded. You can start a run."],
  arming: ["Arming", "The pressure is being switched on. Keep clear."],
  running: ["Running", "The rig moves. Keep clear."],
  held: ["On hold", "The rig keeps its position. The pressure is on. Press Resume or Stop."],
  unloading: ["Unloading", "The rig unloads by itself. Keep clear."],
  interlocked: ["Interlocked", "Remove the cause, then press Reset. Reset does not move the rig."],
};
const PREPARING = ["Preparing", "The profile is being checked. Then the rig moves. Stop withdraws the run."];
let status = null;

// ---- requests

async function ask(path, body) {
  let answer;
  try {
    const options = body === undefined ? {} :
      { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
    answer = await fetch(path, options);
  } catch {
    throw new Error("The daemon does not answer. Check that it runs on this computer.");
  }
  const reply = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Error([reply.error || `HTTP ${answer.status}`, reply.what_to_do].filter(Boolean).join(". "));
  return reply;
}

let noticeTimer = 0;
function say(text, mild) {
  const notice = $("notice");
  clearTimeout(noticeTimer);
  notice.textContent = text;
  notice.classList.toggle("mild", !!mild);
  notice.hidden = !text;
  if (text && mild) noticeTimer = setTimeout(() => { notice.hidden = true; }, 8000);
}

function press(id, action) {
  $(id).addEventListener("click", async () => {
    say("");
    try { await action(); } catch (error) { say(error.message); }
  });
}

press("stop", () => ask("api/stop", { reason: "stopped on the page" }));
press("hold", () => ask("api/hold", {}));
press("resume", () => ask("api/resume", {}));
press("reset", () => ask("api/reset", {}));
press("tare", async () => {
  const t = await ask("api/tare", {});
  say(`New tare: force ${t.force_old_n.toFixed(1)} \u2192 ${t.force_new_n.toFixed(1)} N, ` +
    `displacement ${t.displacement_old_mm.toFixed(3)} \u2192 ${t.displacement_new_mm.toFixed(3)} mm.`, true);
});
press("run", () => start({ profile: $("profile").value }));

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

async function loadProfiles() {
  const profiles = await ask("api/profiles");
  $("profile").replaceChildren(...profiles.map(p => {
    const option = document.createElement("option");
    option.value = p.name;
    option.disabled = !!p.problem;
    option.textContent = p.problem ? `${p.name} (cannot be used)` : p.name;
    option.title = p.problem || p.description;
    return option;
  }));
  const wanted = localStorage.getItem("profile");
  const first = [wanted, "static-ramp"].find(name => profiles.some(p => p.name === name && !p.problem));
  if (first) $("profile").value = first;
  plan();
}

async function plan() {
  const name = $("profile").value, text = $("plan");
  if (!name) return;
  localStorage.setItem("profile", name);
  try {
    const p = await ask("api/plan", { profile: name });
    if ($("profile").value !== name) return;
    text.classList.toggle("bad", p.trips.length > 0);
    text.textContent = p.trips.length > 0 ? "Cannot run: " + p.trips.join("; ") :
      `${duration(p.duration_s)}. Predicted: ${number(p.force_max_n, 0)} N peak, ${number(p.displacement_min_mm, 1)} to ` +
      `${number(p.displacement_max_mm, 1)} mm, ${number(p.velocity_max_mm_s, 0)} mm/s` +
      (p.cycles ? `, ${p.cycles} cycles.` : ".");
  } catch (error) {
    text.classList.add("bad");
    text.textContent = error.message;
  }
}
$("profile").addEventListener("change", plan);
for (const id of ["specimen", "operator"]) {
  $(id).value = localStorage.getItem(id) || "";
  $(id).addEventListener("change", () => localStorage.setItem(id, $(id).value));
}

// ---- status

const number = (value, digits) => value === null || value === undefined ? "\u2013" :
  value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "").replace("-", "\u2212");

function duration(seconds) {
  const s = Math.max(0, Math.round(seconds)), minutes = Math.floor(s / 60);
  if (minutes >= 60) return `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
  return minutes ? `${minutes} min ${String(s % 60).padStart(2, "0")} s` : `${s} s`;
}

let everConnected = false;

function show() {
  const rig = status && status.rig, phase = rig ? rig.phase : "offline";
  $("lamp").dataset.phase = phase;
  const preparing = !!(status && status.preparing);
  const [state, detail] = preparing && phase === "ready" ? PREPARING : PHASES[phase] || (everConnected
    ? ["No daemon", "The connection to the daemon is lost. If the daemon has ended, the rig unloads by itself."]
    : ["Connecting", "Waiting for the daemon."]);
  $("state").textContent = state;
  $("state-detail").textContent = rig && rig.notice && phase !== "running" ? rig.notice : detail;
  $("force").textContent = number(rig && rig.force_n, 1);
  $("displacement").textContent = number(rig && rig.displacement_mm, 3);
  const allow = (id, ...phases) => { $(id).disabled = !phases.includes(phase); };
  // A stop is taken at any time, also while a run is being prepared.
  $("stop").disabled = !status;
  allow("hold", "running");
  allow("resume", "held");
  allow("reset", "interlocked");
  allow("tare", "ready", "interlocked");
  allow("run", ...(preparing ? [] : ["ready"]));
  showRun(rig);
  if (status) $("footer").textContent = [
    `leafbench ${status.version}, bench ${status.bench}, link ${status.link}${status.link_open ? "" : " (closed)"}, ` +
    `runs in ${status.data_folder}`,
    `${rig.counters.samples} samples, ${rig.counters.lost} lost, ${rig.counters.late} late, ${rig.counters.frames_refused} frames refused, ` +
    `largest delay of the control loop ${(status.control_loop.worst_lateness_us / 1000).toFixed(1)} ms`,
    ...status.degraded].join(" \u00b7 ");
}

function showRun(rig) {
  const run = status && status.run, live = rig && rig.run_id;
  if (live) {
    const total = rig.elapsed_s + rig.remaining_s;
    $("run-name").textContent = rig.profile;
    $("run-cycles").textContent = rig.cycles_total ? `cycle ${rig.cycles_completed} of ${rig.cycles_total}` : "";
    $("run-remaining").textContent = `${duration(rig.remaining_s)} left`;
    $("progress").value = total > 0 ? rig.elapsed_s / total : 0;
  } else if (run && run.ending) {
    $("run-name").textContent = `${run.profile}: ${run.ending}`;
    $("run-cycles").textContent = `${run.samples} samples, ${run.lost} lost, ${run.late} late`;
    $("run-remaining").textContent = run.cause;
    $("progress").value = run.ending === "completed" ? 1 : $("progress").value;
  }
  const mismatch = (run && run.model_mismatch) || "";
  $("mismatch").textContent = mismatch;
  $("mismatch").hidden = !mismatch;
  if (run && run.disk_problem) say(`Disk: ${run.disk_problem}.`);
}

// ---- recorded runs

async function loadRuns() {
  const runs = await ask("api/runs");
  if (!runs.length) return;
  $("runs").replaceChildren(...runs.slice(0, 100).map(row));
}

function row(run) {
  const tr = document.createElement("tr");
  const cell = (text, kind) => {
    const td = tr.insertCell();
    td.textContent = text;
    if (kind) td.className = kind;
    return td;
  };
  const started = new Date(run.started_utc);
  cell(isNaN(started) ? run.run_id : started.toLocaleString());
  cell(run.profile);
  cell(run.specimen);
  const ended = cell(run.ending);
  const why = [run.problem, run.cause].filter(Boolean).join(" · ");
  if (why) ended.append(Object.assign(document.createElement("small"), { textContent: why }));
  cell(run.cycles_completed || "", "number");
  cell(run.samples, "number");
  cell(run.lost, "number");
  cell(run.late, "number");
  const links = cell("");
  if (run.started_utc && run.ending !== "open") {
    const link = (text, query) => links.append(
      Object.assign(document.createElement("a"), { textContent: text, href: `api/runs/${run.run_id}/csv${query}` }));
    const whole = run.ending !== "damaged" && run.ending !== "incomplete";
    link(whole ? "all" : "what is left", whole ? "" : "?partial=1");
    if (run.cycles_completed > 1 && whole) link("mean loop", "?mean_loop=true");
  }
  const again = cell("");
  if (run.cycles_completed > 0 && (run.ending === "stopped" || run.ending === "aborted")) {
    const button = Object.assign(document.createElement("button"), { textContent: "Continue" });
    button.title = `Start a new run that begins after cycle ${run.cycles_completed} of this run`;
    button.addEventListener("click", async () => {
      say("");
      try { await start({ profile: null, resume_run: run.run_id }); } catch (error) { say(error.message); }
    });
    again.append(button);
  }
  return tr;
}

// ---- live samples

const MOST_POINTS = 6000;
let points = empty(), runOfPoints = null, controlled = null, dirty = true;

function empty() { return { t: [], x: [], f: [], twin: [], command: [] }; }

function take(batch) {
  if (batch.run_id !== runOfPoints) { runOfPoints = batch.run_id; points = empty(); }
  points.t.push(...batch.time_s);
  points.x.push(...batch.displacement_mm);
  points.f.push(...batch.force_n);
  points.twin.push(...batch.twin_force_n);
  points.command.push(...batch.command);
  controlled = batch.control;
  // Every second point of the older half is dropped: a whole ramp stays in view and the newest cycles keep all their points.
  if (points.t.length > MOST_POINTS) {
    const half = MOST_POINTS / 2;
    for (const key of Object.keys(points)) points[key] = points[key].filter((_, i) => i >= half || i % 2 === 0);
  }
  $("skipped").textContent = batch.skipped ? `This view skipped ${batch.skipped} points. They are in the recording.` : "";
  dirty = true;
}

const loopPlot = new Plot($("loop"), "displacement in mm", "force in N", 1, 20);
const displacementPlot = new Plot($("trace-displacement"), "", "", 0, 1);
const forcePlot = new Plot($("trace-force"), "time in s", "", 0, 20);

function draw() {
  if (dirty) {
    dirty = false;
    const measured = style("--measured"), twin = style("--twin"), command = style("--command");
    const { t, x, f } = points, end = t.length ? t[t.length - 1] : 0;
    const since = seconds => { const i = t.findIndex(v => v >= end - seconds); return i < 0 ? 0 : i; };
    const part = (column, from) => column.slice(from);
    const fresh = since(3);
    loopPlot.draw([
      { x, y: f, colour: measured, width: 1.2, alpha: .35 },
      { x: part(x, fresh), y: part(f, fresh), colour: measured, width: 3 },
      { x: part(x, fresh), y: part(points.twin, fresh), colour: twin, width: 2, dash: [7, 6] },
    ]);
    const seconds = Number($("window").value), from = since(seconds), time = part(t, from);
    const xRange = [Math.max(0, end - seconds), Math.max(end, seconds)];
    const isForce = controlled === "force";
    displacementPlot.draw([
      { x: time, y: isForce ? [] : part(points.command, from), colour: command, width: 3 },
      { x: time, y: part(x, from), colour: measured },
    ], xRange);
    forcePlot.draw([
      { x: time, y: isForce ? part(points.command, from) : [], colour: command, width: 3 },
      { x: time, y: part(f, from), colour: measured },
      { x: time, y: part(points.twin, from), colour: twin, dash: [7, 6] },
    ], xRange);
  }
  requestAnimationFrame(draw);
}

window.addEventListener("resize", () => { dirty = true; });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty = true; });
$("window").addEventListener("change", () => { dirty = true; });

function connect() {
  const socket = new WebSocket(`ws://${location.host}/api/live`);
  socket.onopen = () => {
    everConnected = true;
    loadProfiles().catch(error => say(error.message));
    loadRuns().catch(error => say(error.message));
  };
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    if (message.type === "samples") { take(message); return; }
    const before = status && status.run && status.run.state;
    status = message.status;
    if (before !== (status.run && status.run.state)) loadRuns().catch(error => say(error.message));
    show();
  };
  socket.onclose = () => { status = null; show(); setTimeout(connect, 1000); };
}

show();
connect();
draw();
