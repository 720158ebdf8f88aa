// Diagnoses of runs: asked for here, computed by the daemon one at a time. Their state is the daemon's, so it outlives the page.
"use strict";

// JOBS_SHOWN newest diagnoses are shown. SURELY_MS: time for the second press on Remove, ms.
const JOBS_SHOWN = 10, JOBS_PERIOD_MS = 700, SURELY_MS = 4000;
const FOUND_WORDS = { adequate: "The model is adequate", missing_physics: "The model lacks physics", unexplained: "Not explained" };
// Elements of the jobs by id. They stay, so that focus and report stay where they are.
const jobElements = new Map();
let jobsTimer = 0, jobsNumber = 0;

async function loadDiagnoses() {
  clearTimeout(jobsTimer);
  const number = ++jobsNumber, jobs = (await ask("api/diagnoses")).slice(0, JOBS_SHOWN);
  if (number !== jobsNumber) return;
  $("diagnoses").hidden = !jobs.length;
  for (const [id, element] of jobElements) {
    if (!jobs.some(job => job.id === id)) { element.root.remove(); jobElements.delete(id); }
  }
  jobs.forEach((job, i) => {
    if (!jobElements.has(job.id)) jobElements.set(job.id, jobElement(job.id));
    const { root, show } = jobElements.get(job.id);
    if ($("jobs").children[i] !== root) $("jobs").insertBefore(root, $("jobs").children[i] || null);
    show(job);
  });
  if (jobs.some(job => job.state === "queued" || job.state === "running")) jobsTimer = setTimeout(showDiagnoses, JOBS_PERIOD_MS);
}

// While the daemon is away the list stays as it was; it is loaded again when the daemon is back.
const showDiagnoses = () => loadDiagnoses().catch(() => {});

function jobElement(id) {
  const name = make("h3"), words = make("p"), error = make("p", { className: "bad" }), step = make("p", { className: "hint" });
  const bar = make("progress", { max: 1, value: 0 }), buttons = make("div", { className: "chips" });
  const frame = make("iframe", { title: "Report of the diagnosis", hidden: true });
  frame.setAttribute("sandbox", "");
  bar.setAttribute("aria-label", "Progress of the diagnosis");
  words.setAttribute("role", "status");
  const button = (text, action) => {
    const b = make("button", { textContent: text });
    b.addEventListener("click", async () => {
      say("");
      try { await action(); } catch (error) { say(error.message); }
    });
    buttons.append(b);
    return b;
  };
  const report = button("Show the report", () => {
    frame.hidden = !frame.hidden;
    if (!frame.hidden && !frame.src) frame.src = `api/diagnoses/${id}/report.html`;
    report.textContent = frame.hidden ? "Show the report" : "Hide the report";
    report.setAttribute("aria-expanded", String(!frame.hidden));
  });
  const tab = make("a", { textContent: "Report in a new tab", href: `api/diagnoses/${id}/report.html`, target: "_blank" });
  buttons.append(tab);
  const twin = button("Use the improved model as twin", () => chooseTwin(id));
  const next = button("Run the next test", () => planNextTest(id));
  // A diagnosis that is over is removed with its files at the second press: a dialog would keep the keys from Stop.
  let isPending = true, surelyUntil = 0;
  const cancel = button("Cancel", async () => {
    if (!isPending && performance.now() > surelyUntil) {
      surelyUntil = performance.now() + SURELY_MS;
      cancel.textContent = "Press again to remove";
      setTimeout(showDiagnoses, SURELY_MS);
      return;
    }
    await ask(`api/diagnoses/${id}`, undefined, 0, { method: "DELETE" });
    await loadDiagnoses();
  });
  const root = make("li", { id: `job-${id}` }, name, words, error, bar, step, buttons, frame);
  const show = job => {
    const pending = job.state === "queued" || job.state === "running", found = job.found;
    const set = (element, text) => { if (element.textContent !== text) element.textContent = text; element.hidden = !text; };
    set(name, `Diagnosis of ${job.runs.length === 1 ? "run" : `${job.runs.length} runs:`} ${job.runs.join(", ")}`);
    set(words, found ? `${FOUND_WORDS[found.verdict] || found.verdict}. ${found.summary}` :
      { queued: "It waits for the diagnosis before it.", running: "", failed: "It failed.", cancelled: "It was cancelled." }[job.state] || "");
    set(error, sentence(job.error));
    bar.hidden = !pending;
    bar.value = job.share;
    set(step, job.state === "running" ? `${Math.round(100 * job.share)} %: ${job.step}` : found && found.next_test ? `Next test: ${found.next_test}` : "");
    report.hidden = tab.hidden = !found;
    twin.hidden = !found || !found.improved;
    next.hidden = !found || !found.next_test;
    isPending = pending;
    if (performance.now() > surelyUntil) cancel.textContent = pending ? "Cancel" : "Remove";
  };
  return { root, show };
}

async function chooseTwin(diagnosis) {
  const { message } = await ask("api/twin", { diagnosis });
  say(sentence(message), true);
  plan();
}

// The next test is planned as any other profile; the technician starts it.
async function planNextTest(id) {
  const answer = await fetch(`api/diagnoses/${id}/next-test.toml`);
  if (!answer.ok) throw new Error("The profile of the next test cannot be read. Diagnose again.");
  offerProfile(`next-test-${id}`, `next test (${id.slice(-4)})`, await answer.text());
  say("The next test is chosen. Read its plan, then press Run.", true);
  $("profile").scrollIntoView({ block: "center" });
  $("profile").focus();
}

// Which model the next run's twin has.
function showTwin() {
  write("twin-model", status ? `Twin of the next run: ${status.twin || "off"}` : "");
  $("twin-own").hidden = !status || !status.twin_diagnosis;
}

press("twin-own", () => chooseTwin(null));
press("diagnose", () => askForDiagnosis([...chosenRuns.keys()]));

async function askForDiagnosis(runs) {
  await ask("api/diagnoses", { runs });
  await loadDiagnoses();
  $("diagnoses").scrollIntoView({ block: "nearest" });
}
