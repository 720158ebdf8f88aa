// The plots: what the rig measures now, between two runs too. Nothing is drawn as live that is not heard.
"use strict";

const MOST_POINTS = 6000;
// Samples that are older than this are not live, ms.
const STALE_MS = 1000;
let points = emptyPoints(), before = { x: [], f: [] }, runOfPoints = null, controlled = null, dirty = true;
let peaks = noPeaks(), samplesAt = 0;

function emptyPoints() { return { t: [], x: [], f: [], twin: [], command: [] }; }
function noPeaks() { return { force: null, displacement: null }; }

const wider = (range, more) => !more ? range : !range ? more : [Math.min(range[0], more[0]), Math.max(range[1], more[1])];

function take(batch) {
  if (batch.run_id !== runOfPoints) {
    // The loop of a run that has just ended stays in view.
    if (runOfPoints) before = { x: points.x, f: points.f };
    if (batch.run_id) { before = { x: [], f: [] }; peaks = noPeaks(); }
    runOfPoints = batch.run_id;
    points = emptyPoints();
  }
  points.t.push(...batch.time_s);
  points.x.push(...batch.displacement_mm);
  points.f.push(...batch.force_n);
  points.twin.push(...batch.twin_force_n);
  points.command.push(...batch.command);
  peaks = { force: wider(peaks.force, batch.force_range_n), displacement: wider(peaks.displacement, batch.displacement_range_mm) };
  controlled = batch.control;
  thinOut();
  $("skipped").textContent = batch.skipped ? `This view skipped ${batch.skipped} points. They are in the recording.` : "";
  samplesAt = performance.now();
  dirty = true;
}

// In a run every second point of the older half is dropped: a whole ramp stays in view and the newest cycles keep all their
// points. Between two runs the oldest points are dropped.
function thinOut() {
  if (points.t.length <= MOST_POINTS) return;
  const half = MOST_POINTS / 2;
  for (const key of Object.keys(points)) {
    points[key] = runOfPoints ? points[key].filter((_, i) => i >= half || i % 2 === 0) : points[key].slice(half);
  }
}

// A page that has just been opened gets the samples of the last seconds before the first status: they are live.
const isLive = () => (!status || status.rig.phase !== "connecting") && performance.now() - samplesAt < STALE_MS;

// The traces of a rig that is not heard any more are taken away.
function forgetStale() {
  if (isLive() || !points.t.length) return;
  if (runOfPoints) before = { x: points.x, f: points.f };
  runOfPoints = null;
  points = emptyPoints();
  dirty = true;
}

const loopPlot = new Plot($("loop"), "displacement in mm", "force in N", 1, 50);
const displacementPlot = new Plot($("trace-displacement"), "", "", 0, 1);
const forcePlot = new Plot($("trace-force"), "", "", 0, 50);
const residualPlot = new Plot($("trace-residual"), "time in s", "", 0, 10);

function draw() {
  forgetStale();
  if (dirty) {
    dirty = false;
    drawPlots();
  }
  requestAnimationFrame(draw);
}

function drawPlots() {
  const measured = style("--measured"), older = style("--older"), twin = style("--twin"), command = style("--command");
  const scale = status && status.plot || {}, silent = isLive() ? "" : "not live";
  const { t, x, f } = points, end = t.length ? t[t.length - 1] : 0;
  const since = seconds => { const i = t.findIndex(v => v >= end - seconds); return i < 0 ? 0 : i; };
  const part = (column, from) => column.slice(from);
  const forceLimits = [scale.force_min_n, scale.force_max_n], displacementLimits = [scale.displacement_min_mm, scale.displacement_max_mm];
  const forceBands = bandsOf("peak force", "valley force");
  const fresh = since(3);
  loopPlot.draw([
    { x: before.x, y: before.f, colour: older, width: 1.5 },
    { x: part(x, runOfPoints ? 0 : since(20)), y: part(f, runOfPoints ? 0 : since(20)), colour: older, width: 1.5 },
    { x: part(x, fresh), y: part(f, fresh), colour: measured, width: 3 },
    { x: part(x, fresh), y: part(points.twin, fresh), colour: twin, width: 2, dash: [7, 6] },
  ], { yLimits: forceLimits, xLimits: displacementLimits, bands: forceBands, silent });
  const seconds = Number($("window").value), from = since(seconds), time = part(t, from);
  const xRange = [Math.max(0, end - seconds), Math.max(end, seconds)];
  const isForce = controlled === "force";
  displacementPlot.draw([
    { x: time, y: isForce ? [] : part(points.command, from), colour: command, width: 3 },
    { x: time, y: part(x, from), colour: measured },
  ], { xRange, yLimits: displacementLimits, bands: bandsOf("peak displacement", "valley displacement"), silent });
  forcePlot.draw([
    { x: time, y: isForce ? part(points.command, from) : [], colour: command, width: 3 },
    { x: time, y: part(f, from), colour: measured },
    { x: time, y: part(points.twin, from), colour: twin, dash: [7, 6] },
  ], { xRange, yLimits: forceLimits, bands: forceBands, silent });
  const band = 3 * (scale.noise_n || 0);
  const residual = time.map((_, i) => {
    const model = points.twin[from + i], force = f[from + i];
    return model === null || force === null ? null : force - model;
  });
  residualPlot.draw([{ x: time, y: residual, colour: measured, width: 1.5 }],
    { xRange, bands: [[-band, band]], silent: silent || (residual.some(v => v !== null) ? "" : "no twin now") });
}

window.addEventListener("resize", () => { dirty = true; });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { dirty = true; });
$("window").addEventListener("change", () => { dirty = true; });
$("clear-peaks").addEventListener("click", () => { peaks = noPeaks(); showPeaks(); });

function showPeaks() {
  const live = isLive();
  const text = (range, digits, unit) => range && live ? `peaks ${number(range[0], digits)}, ${number(range[1], digits)} ${unit}` : "\u00a0";
  $("force-peak").textContent = text(peaks.force, 1, "N");
  $("displacement-peak").textContent = text(peaks.displacement, 3, "mm");
}
