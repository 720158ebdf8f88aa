// The limits that a run is judged by, before it and during it: as text beside the plan, and as bands in the plots.
"use strict";

// Limits of the run under way. They are asked for once, because they do not change.
let runLimits = { runId: null, profile: "", limits: [] };

async function followRunLimits() {
  const runId = status && status.rig && status.rig.run_id;
  if (!runId || runLimits.runId === runId) return;
  runLimits = { runId, profile: status.rig.profile, limits: [] };
  try {
    const found = await ask(`api/runs/${encodeURIComponent(runId)}/result`);
    if (runLimits.runId === runId) runLimits = { runId, profile: found.profile, limits: found.limits };
  } catch { runLimits.runId = null; return; }
  showLimits();
}

// The limits that count now: those of the run under way, or else of the chosen profile.
function limitsNow() {
  const runId = status && status.rig && status.rig.run_id;
  return runId && runLimits.runId === runId ? runLimits : { profile: planned.name, limits: planned.limits || [] };
}

const isPredicted = profile => profile.endsWith("-predicted");

// Lower and upper limit of one value over the same cycles; Infinity where there is none.
function limitPairs(limits) {
  const pairs = new Map();
  for (const l of limits) {
    const key = `${l.what} ${l.cycles || ""}`;
    const pair = pairs.get(key) || { what: l.what, unit: l.unit, cycles: l.cycles, low: -Infinity, high: Infinity };
    if (l.side === "min") pair.low = Math.max(pair.low, l.limit); else pair.high = Math.min(pair.high, l.limit);
    pairs.set(key, pair);
  }
  return [...pairs.values()];
}

function pairWords({ what, unit, low, high }) {
  const range = low === -Infinity ? `at most ${digits(high)}` : high === Infinity ? `at least ${digits(low)}` : `${digits(low)} to ${digits(high)}`;
  return `${what} ${range} ${unit}`.trim();
}

function showLimits() {
  const { profile, limits } = limitsNow();
  const lines = new Map();
  for (const pair of limitPairs(limits)) {
    const cycles = pair.cycles ? `Cycles ${pair.cycles[0]} to ${pair.cycles[1]}` : "Whole run";
    lines.set(cycles, [...(lines.get(cycles) || []), pairWords(pair)]);
  }
  const text = [...lines].map(([cycles, words]) => `${cycles}: ${words.join(", ")}.`);
  const list = $("limits"), shown = [profile, ...text].join("\n");
  if (list.dataset.shown === shown) return;
  list.dataset.shown = shown;
  write("limits-title", !text.length ? "" : isPredicted(profile) ? "Limits, with the predicted band" : "Limits of the profile");
  list.replaceChildren(...text.map(line => el("li", line)));
  // An empty list is no stop for the Tab key.
  list.parentElement.hidden = !text.length;
  dirty = true;
}

// Bands of two values in a plot. In a run only those of the cycle that is played.
function bandsOf(...values) {
  const rig = status && status.rig, cycle = rig && rig.run_id && rig.cycles_total ? rig.cycles_completed + 1 : null;
  const counts = p => cycle === null || !p.cycles || cycle >= p.cycles[0] && cycle <= p.cycles[1];
  const closed = p => p.low !== -Infinity && p.high !== Infinity;
  return limitPairs(limitsNow().limits).filter(p => values.includes(p.what) && closed(p) && counts(p)).map(p => [p.low, p.high]);
}
