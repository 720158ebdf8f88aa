// Draws plots on a canvas: axes with round steps that stay where they are, lines with gaps, limits, a band; colours from the
// page's style.
"use strict";

const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// The step of 1, 2 or 5 times a power of ten that divides `span` into about `count` parts.
function roundStep(span, count) {
  const rough = span / count, power = 10 ** Math.floor(Math.log10(rough)), mantissa = rough / power;
  return power * (mantissa < 1.5 ? 1 : mantissa < 3.5 ? 2 : mantissa < 7.5 ? 5 : 10);
}

// Lowest and highest value, at least `least` apart.
function rangeOf(columns, least) {
  let low = Infinity, high = -Infinity;
  for (const column of columns) for (const v of column) if (v !== null && v !== undefined) {
    if (v < low) low = v;
    if (v > high) high = v;
  }
  if (low > high) { low = 0; high = 0; }
  const middle = (low + high) / 2, half = Math.max(high - low, least) / 2;
  return [middle - half, middle + half];
}

// A range of round ends around `wanted`. The one in use stays as long as it holds all points and is not far too wide.
function steadyRange(used, wanted) {
  const [low, high] = wanted, span = high - low;
  if (used && used[0] <= low && used[1] >= high && used[1] - used[0] < 3 * span) return used;
  const step = roundStep(span, 4);
  return [Math.floor(low / step - 0.2) * step, Math.ceil(high / step + 0.2) * step];
}

class Plot {
  constructor(canvas, xLabel, yLabel, xLeast, yLeast) {
    Object.assign(this, { canvas, xLabel, yLabel, xLeast, yLeast, x: null, y: null });
  }

  // lines: [{x, y, colour, width, dash}]. Without xRange the abscissa holds all points. xLimits, yLimits: lines where they are
  // within the plot. bands: shaded ranges of the ordinate. silent: why nothing is live; drawn across the plot.
  draw(lines, { xRange, xLimits, yLimits, bands, silent }) {
    const { canvas } = this, ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const c = canvas.getContext("2d");
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    c.font = "14px system-ui, sans-serif";
    this.x = xRange || steadyRange(this.x, rangeOf(lines.map(l => l.x), this.xLeast));
    this.y = steadyRange(this.y, rangeOf([...lines.map(l => l.y), ...(bands || [])], this.yLeast));
    const [[x0, x1], [y0, y1]] = [this.x, this.y];
    const box = { left: 76, right: width - 16, top: 8, bottom: height - (this.xLabel ? 44 : 24) };
    const px = x => box.left + (x - x0) / (x1 - x0) * (box.right - box.left);
    const py = y => box.bottom - (y - y0) / (y1 - y0) * (box.bottom - box.top);
    c.save();
    c.beginPath();
    c.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    c.clip();
    c.fillStyle = style("--band");
    for (const [low, high] of bands || []) {
      // A narrow band is drawn wide enough to be seen.
      const tall = Math.max(py(low) - py(high), 4);
      c.fillRect(box.left, (py(low) + py(high) - tall) / 2, box.right - box.left, tall);
    }
    c.restore();
    this.axes(c, box, px, py);
    c.save();
    c.beginPath();
    c.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    c.clip();
    this.limits(c, box, px, py, xLimits || [], yLimits || []);
    lines.forEach(line => this.line(c, px, py, line));
    c.restore();
    if (silent) this.say(c, box, silent);
  }

  line(c, px, py, { x, y, colour, width, dash }) {
    c.lineJoin = "round";
    c.strokeStyle = colour;
    c.lineWidth = width || 2;
    c.setLineDash(dash || []);
    c.beginPath();
    let pen = false;
    for (let i = 0; i < x.length; i++) {
      if (y[i] === null || y[i] === undefined || x[i] === null) { pen = false; continue; }
      if (pen) c.lineTo(px(x[i]), py(y[i])); else c.moveTo(px(x[i]), py(y[i]));
      pen = true;
    }
    c.stroke();
    c.setLineDash([]);
  }

  limits(c, box, px, py, xLimits, yLimits) {
    c.strokeStyle = style("--limit");
    c.lineWidth = 2;
    c.setLineDash([12, 4, 2, 4]);
    for (const x of xLimits) { c.beginPath(); c.moveTo(px(x), box.top); c.lineTo(px(x), box.bottom); c.stroke(); }
    for (const y of yLimits) { c.beginPath(); c.moveTo(box.left, py(y)); c.lineTo(box.right, py(y)); c.stroke(); }
    c.setLineDash([]);
  }

  say(c, box, text) {
    c.fillStyle = style("--quiet");
    c.textAlign = "center";
    c.textBaseline = "middle";
    c.font = "16px system-ui, sans-serif";
    c.fillText(text, (box.left + box.right) / 2, (box.top + box.bottom) / 2);
  }

  axes(c, box, px, py) {
    const [[x0, x1], [y0, y1]] = [this.x, this.y];
    c.strokeStyle = style("--line");
    c.fillStyle = style("--quiet");
    c.lineWidth = 1;
    const text = (value, step) => {
      const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      return (Math.abs(value) < step / 1e6 ? 0 : value).toFixed(digits).replace("-", "\u2212");
    };
    const xStep = roundStep(x1 - x0, Math.max(2, (box.right - box.left) / 90));
    const yStep = roundStep(y1 - y0, Math.max(2, (box.bottom - box.top) / 34));
    c.textAlign = "center";
    c.textBaseline = "top";
    for (let x = Math.ceil(x0 / xStep) * xStep; x <= x1 + xStep * 1e-9; x += xStep) {
      c.beginPath(); c.moveTo(px(x), box.top); c.lineTo(px(x), box.bottom); c.stroke();
      c.fillText(text(x, xStep), px(x), box.bottom + 6);
    }
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (let y = Math.ceil(y0 / yStep - 1e-9) * yStep; y <= y1 + yStep * 1e-9; y += yStep) {
      c.beginPath(); c.moveTo(box.left, py(y)); c.lineTo(box.right, py(y)); c.stroke();
      c.fillText(text(y, yStep), box.left - 8, py(y));
    }
    c.textAlign = "center";
    if (this.xLabel) c.fillText(this.xLabel, (box.left + box.right) / 2, box.bottom + 34);
    if (this.yLabel) {
      c.save();
      c.translate(12, (box.top + box.bottom) / 2);
      c.rotate(-Math.PI / 2);
      c.fillText(this.yLabel, 0, 0);
      c.restore();
    }
  }
}
