// Two runs over each other: force over displacement of both, the difference, and the figures side by side.
"use strict";

const FIGURES = [["force_max_n", "highest force", "N", 1], ["force_min_n", "lowest force", "N", 1],
  ["displacement_max_mm", "highest displacement", "mm", 3], ["displacement_min_mm", "lowest displacement", "mm", 3],
  ["energy_j", "energy per cycle", "J", 3], ["secant_rate_n_per_mm", "secant rate", "N/mm", 2], ["twin_nrmse", "error of the twin", "%", 2]];
const comparePlot = new Plot($("compare-loop"), "displacement in mm", "force in N", 1, 50);
const differencePlot = new Plot($("compare-difference"), "displacement in mm", "difference in N", 1, 10);
let compared = null;

async function compareRuns(first, second) {
  compared = await ask(`api/compare?first=${encodeURIComponent(first)}&second=${encodeURIComponent(second)}`);
  $("comparison").hidden = false;
  comparePlot.x = comparePlot.y = differencePlot.x = differencePlot.y = null;
  const { first: a, second: b, difference: d } = compared;
  const what = run => `${run.summary.profile}, ${run.summary.specimen}, ${new Date(run.summary.started_utc).toLocaleString()}` +
    (run.cycles ? `: mean of ${run.cycles} cycles` : ": whole motion");
  write("compare-first", what(a));
  write("compare-second", what(b));
  const figure = (run, [key, , unit, digits]) => {
    const value = run.figures[key];
    return number(value === null || unit !== "%" ? value : 100 * value, digits);
  };
  const minus = ([key, , unit, digits]) => {
    const [x, y] = [a.figures[key], b.figures[key]];
    return number(x === null || y === null ? null : (x - y) * (unit === "%" ? 100 : 1), digits);
  };
  const row = cells => make("tr", {}, ...cells.map((text, i) => make("td", { textContent: text, className: i ? "number" : "" })));
  $("compare-figures").replaceChildren(
    ...FIGURES.map(f => row([`${f[1]} in ${f[2]}`, figure(a, f), figure(b, f), minus(f)])),
    ...[["completed cycles", "cycles_completed"], ["lost samples", "lost"]].map(([name, key]) =>
      row([name, a.summary[key], b.summary[key], number(a.summary[key] - b.summary[key], 0)])));
  write("compare-words", d.rms_n === null ? "The two runs have no displacement in common, so there is no difference to draw." :
    `First minus second, at equal displacement and direction: ${number(d.rms_n, 2)} N root mean square, ` +
    `${number(d.largest_n, 1)} N at most.`);
  drawComparison();
}

function drawComparison() {
  if (!compared || $("comparison").hidden) return;
  const { first: a, second: b, difference: d } = compared, one = style("--measured"), two = style("--twin");
  comparePlot.draw([
    { x: a.displacement_mm, y: a.force_n, colour: one, width: 2.5 },
    { x: b.displacement_mm, y: b.force_n, colour: two, width: 2, dash: [7, 5] },
  ], {});
  differencePlot.draw([
    { x: d.displacement_mm, y: d.loading_n, colour: one, width: 2.5 },
    { x: d.displacement_mm, y: d.unloading_n, colour: two, width: 2, dash: [7, 5] },
  ], { band: [0, 0], silent: d.rms_n === null ? "nothing in common" : "" });
}

press("compare", async () => {
  const [first, second] = [...chosenRuns.values()].sort((a, b) => a.started_utc < b.started_utc ? -1 : 1);
  await compareRuns(first.run_id, second.run_id);
  $("comparison").scrollIntoView({ block: "start" });
});
$("compare-close").addEventListener("click", () => {
  $("comparison").hidden = true;
  compared = null;
  $("compare").focus();
});
window.addEventListener("resize", drawComparison);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawComparison);
