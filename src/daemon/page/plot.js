// Draws plots on a canvas: axes with round steps, lines with gaps, colours from the page's style.
"use strict";

const style = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// The step of 1, 2 or 5 times a power of ten that divides `span` into about `count` parts.
function roundStep(span, count) {
  const rough = span / count, power = 10 ** Math.floor(Math.log10(rough)), mantissa = rough / power;
  return power * (mantissa < 1.5 ? 1 : mantissa < 3.5 ? 2 : mantissa < 7.5 ? 5 : 10);
}

function rangeOf(columns, least) {
  let low = Infinity, high = -Infinity;
  for (const column of columns) for (const v of column) if (v !== null && v !== undefined) {
    if (v < low) low = v;
    if (v > high) high = v;
  }
  if (low > high) { low = 0; high = least; }
  const middle = (low + high) / 2, half = Math.max(high - low, least) / 2 * 1.06;
  return [middle - half, middle + half];
}

class Plot {
  constructor(canvas, xLabel, yLabel, xLeast, yLeast) {
    Object.assign(this, { canvas, xLabel, yLabel, xLeast, yLeast });
  }

  // lines: [{x, y, colour, width, alpha, dash}]. Without xRange the abscissa holds all points.
  draw(lines, xRange) {
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
    const [x0, x1] = xRange || rangeOf(lines.map(l => l.x), this.xLeast);
    const [y0, y1] = rangeOf(lines.map(l => l.y), this.yLeast);
    const box = { left: 76, right: width - 10, top: 8, bottom: height - (this.xLabel ? 44 : 24) };
    const px = x => box.left + (x - x0) / (x1 - x0) * (box.right - box.left);
    const py = y => box.bottom - (y - y0) / (y1 - y0) * (box.bottom - box.top);
    this.axes(c, box, px, py, [x0, x1], [y0, y1]);
    c.save();
    c.beginPath();
    c.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
    c.clip();
    c.lineJoin = "round";
    for (const line of lines) {
      c.strokeStyle = line.colour;
      c.globalAlpha = line.alpha || 1;
      c.lineWidth = line.width || 2;
      c.setLineDash(line.dash || []);
      c.beginPath();
      let pen = false;
      for (let i = 0; i < line.x.length; i++) {
        const y = line.y[i];
        if (y === null || y === undefined) { pen = false; continue; }
        if (pen) c.lineTo(px(line.x[i]), py(y)); else c.moveTo(px(line.x[i]), py(y));
        pen = true;
      }
      c.stroke();
    }
    c.restore();
  }

  axes(c, box, px, py, [x0, x1], [y0, y1]) {
    c.strokeStyle = style("--line");
    c.fillStyle = style("--quiet");
    c.lineWidth = 1;
    const text = (value, step) => {
      const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
      return (Math.abs(value) < step / 1e6 ? 0 : value).toFixed(digits).replace("-", "\u2212");
    };
    const xStep = roundStep(x1 - x0, Math.max(2, (box.right - box.left) / 90));
    const yStep = roundStep(y1 - y0, Math.max(2, (box.bottom - box.top) / 46));
    c.textAlign = "center";
    c.textBaseline = "top";
    for (let x = Math.ceil(x0 / xStep) * xStep; x <= x1; x += xStep) {
      c.beginPath(); c.moveTo(px(x), box.top); c.lineTo(px(x), box.bottom); c.stroke();
      c.fillText(text(x, xStep), px(x), box.bottom + 6);
    }
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (let y = Math.ceil(y0 / yStep) * yStep; y <= y1; y += yStep) {
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
