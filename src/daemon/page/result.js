// The result of a run: one panel over the plots when it ends, so that nothing moves. It closes when the rig moves again.
"use strict";

const VERDICTS = { pass: "Pass", fail: "Fail", not_judged: "Not judged", no_limits: "No limits" };
let resultOf = null, resultAsked = null, resultShown = null, resultPlots = [];

const el = (tag, text, kind) => Object.assign(document.createElement(tag), { textContent: text, className: kind || "" });

// Five significant digits, without zeros at the end.
function digits(value) {
  if (value === null || value === undefined) return "\u2013";
  const decimals = value === 0 ? 0 : Math.min(9, Math.max(0, 4 - Math.floor(Math.log10(Math.abs(value)))));
  const text = value.toFixed(decimals);
  return (text.includes(".") ? text.replace(/\.?0+$/, "") : text).replace("-", "\u2212");
}

const withUnit = (value, unit) => value === null ? "\u2013" : `${digits(value)} ${unit}`.trim();

// The panel opens by itself at the end of a run, and by its button.
function followResult() {
  const run = status && status.run, rig = status && status.rig;
  const over = run && run.state === "ended" ? run.run_id : null;
  $("result-open").disabled = !over;
  if (rig && ["arming", "running", "held"].includes(rig.phase)) closeResult();
  if (over && resultAsked !== over && (!rig || !rig.run_id)) openResult(over);
}

async function openResult(runId) {
  resultAsked = runId;
  try {
    resultOf = await ask(`api/runs/${encodeURIComponent(runId)}/result`);
  } catch (error) { say(error.message); return; }
  if (resultAsked !== runId) return;
  showResult(resultOf);
}

function closeResult() {
  if (!resultShown) return;
  resultShown = null;
  $("result").hidden = true;
  $("result-open").hidden = false;
}

function showResult(r) {
  resultShown = r.run_id;
  $("result-verdict").textContent = VERDICTS[r.verdict];
  $("result-verdict").dataset.verdict = r.verdict;
  const ending = r.ending || "has no end yet";
  const cause = r.cause ? `: ${withoutWord(r.cause, ending)}` : "";
  $("result-ending").textContent = `${r.profile} on ${r.specimen}: ${ending}${cause}`;
  $("result-why").textContent = [r.why, r.problem].filter(Boolean).map(sentence).join(" ");
  $("result-certificate").href = `api/runs/${encodeURIComponent(r.run_id)}/certificate`;
  const first = { fail: 0, not_judged: 1, pass: 2 };
  const limits = [...r.limits].sort((a, b) => first[a.verdict] - first[b.verdict]);
  $("result-limits").replaceChildren(...limits.map(limitRow));
  $("result-no-limits").hidden = r.limits.length > 0;
  $("result-limits-table").hidden = r.limits.length === 0;
  const counted = r.cycles_planned > 0;
  $("result-heads").replaceChildren(...(counted ? ["Value", "First", "Last", "Mean", "Trend"] : ["Value", "Whole motion"])
    .map((text, i) => el("th", text, i ? "number" : "")));
  $("result-values").replaceChildren(...r.values.map(v => valueRow(v, counted)),
    countRow(`${r.samples} samples, ${r.lost} lost, ${r.late} late, ${r.flagged} flagged`, counted));
  $("result").hidden = false;
  $("result-open").hidden = true;
  drawResult();
}

function limitRow(l) {
  const tr = document.createElement("tr");
  const cycles = l.cycles ? `, cycles ${l.cycles[0]} to ${l.cycles[1]}` : "";
  const what = el("td", `${l.what} ${l.side === "min" ? "at least" : "at most"} ${withUnit(l.limit, l.unit)}${cycles}`);
  if (l.why) what.append(el("small", ` (${l.why})`));
  const verdict = el("td", "");
  const chip = el("span", VERDICTS[l.verdict], "verdict");
  chip.dataset.verdict = l.verdict;
  verdict.append(chip);
  tr.append(what, el("td", withUnit(l.measured, l.unit) + (l.at_cycle ? `, cycle ${l.at_cycle}` : ""), "number"), verdict);
  return tr;
}

function valueRow(v, counted) {
  const tr = document.createElement("tr");
  const name = el("td", v.unit ? `${v.what}, ${v.unit}` : v.what);
  const cells = counted ? [digits(v.first), digits(v.last), digits(v.mean),
    v.trend === null ? "\u2013" : `${digits(Number(v.trend.toPrecision(3)))} ${v.trend_unit}`] : [digits(v.mean)];
  tr.append(name, ...cells.map(text => el("td", text, "number")));
  return tr;
}

function countRow(text, counted) {
  const tr = document.createElement("tr");
  tr.append(Object.assign(el("td", text), { colSpan: counted ? 5 : 2 }));
  return tr;
}

// Peak force, energy and rate over the number of the cycle, with the limits of the profile.
function drawResult() {
  if (!resultShown) return;
  const rows = resultOf.cycles.filter(c => c.complete);
  // One cycle has no trend: the tables get the room.
  $("result-plots").hidden = rows.length < 2;
  if (rows.length < 2) return;
  resultPlots = resultPlots.length ? resultPlots : [
    ["result-peak", "force_peak_n", "peak force"], ["result-energy", "loop_energy_j", "loop energy"],
    ["result-rate", "secant_rate_n_per_mm", "secant rate"]].map(([id, key, what]) => ({ id, key, what }));
  for (const { id, key, what } of resultPlots) {
    const y = rows.map(c => c[key]), found = y.filter(v => v !== null);
    const least = found.length ? Math.max(...found.map(Math.abs)) * 0.01 || 1 : 1;
    const plot = new Plot($(id), "", "", 3, least);
    plot.draw([{ x: rows.map(c => c.cycle), y, colour: style("--measured"), width: 2.5 }], {
      yLimits: resultOf.limits.filter(l => l.what === what).map(l => l.limit),
    });
  }
}

$("result-close").addEventListener("click", closeResult);
$("result-open").addEventListener("click", () => openResult(status.run.run_id));
window.addEventListener("resize", drawResult);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawResult);
