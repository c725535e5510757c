"use strict";
// Draws the figures of a page with uPlot. A figure is a stack of panels over one horizontal axis; kinds of traces:
// line, markers, area (between two curves), shade (intervals of x), trail (any direction), matrix (coloured cells).
// Colours are written @name or @name/opacity, so that one figure serves light and dark.
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const plots = [...document.querySelectorAll(".plot")];
const PRINT_WIDTH = 690, PRINT_HALF = 338, PRINT_SHARE = 0.4;
const charts = new Map();  // of each plot, its panels
const GAP = 65535;
const DASHES = { "": [], dot: [2, 3], dash: [6, 4] };

function colour(text, palette) {
  if (text[0] !== "@") return text;
  const [name, opacity] = text.slice(1).split("/");
  return opacity ? `rgba(${palette[name]},${opacity})` : `rgb(${palette[name]})`;
}

function unpack(array) {
  const bytes = Uint8Array.from(atob(array.data), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer), out = new Array(bytes.length / 2);
  for (let i = 0; i < out.length; i++) {
    const level = view.getUint16(2 * i, true);
    out[i] = level === GAP ? null : array.low + level * array.step;
  }
  return out;
}

// uPlot needs ascending x without repetition and without gaps
function table(x, ...columns) {
  const step = 1e-9 * Math.max(1, ...x.filter((v) => v !== null).map(Math.abs));
  const out = [[], ...columns.map(() => [])];
  let last = -Infinity;
  x.forEach((v, i) => {
    const at = v === null ? last + step : Math.max(v, last + step);
    if (at === -Infinity) return;
    last = at;
    out[0].push(at);
    columns.forEach((column, k) => out[k + 1].push(v === null ? null : column[i]));
  });
  return out;
}

function number(value) {
  if (value === null || value === undefined || !isFinite(value)) return "–";
  const text = Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3)
    ? value.toExponential(2) : String(+value.toPrecision(4));
  return text.replace("-", "−");
}

function mark(context, symbol, x, y, size) {
  const r = size / 2;
  context.beginPath();
  if (symbol === "cross") {
    context.moveTo(x - r, y - r); context.lineTo(x + r, y + r);
    context.moveTo(x - r, y + r); context.lineTo(x + r, y - r);
    context.stroke();
  } else if (symbol === "diamond") {
    context.moveTo(x, y - r); context.lineTo(x + r, y); context.lineTo(x, y + r); context.lineTo(x - r, y);
    context.closePath(); context.stroke();
  } else {
    context.arc(x, y, r, 0, 2 * Math.PI); context.fill();
  }
}

// What uPlot does not draw by itself, in its canvas; behind: before the series.
function paint(u, traces, palette, scale, behind) {
  const c = u.ctx, box = u.bbox;
  c.save();
  c.beginPath(); c.rect(box.left, box.top, box.width, box.height); c.clip();
  const px = (v) => u.valToPos(v, "x", true), py = (v) => u.valToPos(v, "y", true);
  for (const t of traces) {
    c.fillStyle = c.strokeStyle = colour(t.colour, palette);
    c.lineWidth = (t.width || 1) * scale;
    c.setLineDash((DASHES[t.dash || ""] || []).map((d) => d * scale));
    if (t.kind === "shade" && behind) {
      t.ends[0].forEach((a, i) => c.fillRect(px(a), box.top, Math.max(px(t.ends[1][i]) - px(a), 1), box.height));
    } else if (t.kind === "matrix" && behind) {
      const n = t.names.length, side = Math.abs(px(1) - px(0)) + 0.6;
      t.cells.forEach((v, k) => {
        if (v === null) return;
        c.fillStyle = colour(`@${v < 0 ? "y" : "x"}/${Math.abs(v).toFixed(3)}`, palette);
        c.fillRect(px((k % n) - 0.5), py(n - 0.5 - Math.floor(k / n)), side, side);
      });
    } else if (t.kind === "trail" && !behind) {
      if (t.spots) t.path[0].forEach((x, i) => mark(c, "disc", px(x), py(t.path[1][i]), t.spots * scale));
      else {
        c.beginPath();
        let down = false;
        t.path[0].forEach((x, i) => {
          const y = t.path[1][i];
          if (x === null || y === null) { down = false; return; }
          if (down) c.lineTo(px(x), py(y)); else c.moveTo(px(x), py(y));
          down = true;
        });
        c.stroke();
      }
      if (t.label) {
        c.font = `${12 * scale}px system-ui, sans-serif`;
        const k = t.path[0].length - 1;
        c.fillText(t.label, px(t.path[0][k]) + 4 * scale, py(t.path[1][k]) - 4 * scale);
      }
    } else if (t.kind === "markers" && !behind) {
      c.globalAlpha = t.opacity || 1;
      c.lineWidth = 1.3 * scale;
      t.path[0].forEach((x, i) => {
        const y = t.path[1][i];
        if (x === null || y === null) return;
        if (t.bars) {
          c.beginPath(); c.moveTo(px(x), py(y - t.bars[i])); c.lineTo(px(x), py(y + t.bars[i])); c.stroke();
        }
        mark(c, t.symbol, px(x), py(y), (t.size || 4) * scale);
      });
      c.globalAlpha = 1;
    }
  }
  c.restore();
}

function rules(u, panel, palette, scale) {
  const c = u.ctx, box = u.bbox;
  c.save();
  c.strokeStyle = colour("@line/0.6", palette);
  c.lineWidth = scale;
  for (const v of panel.rules || []) {
    const x = u.valToPos(v, "x", true);
    c.beginPath(); c.moveTo(x, box.top); c.lineTo(x, box.top + box.height); c.stroke();
    if (panel.equal) {
      const y = u.valToPos(panel.size - 1 - v, "y", true);
      c.beginPath(); c.moveTo(box.left, y); c.lineTo(box.left + box.width, y); c.stroke();
    }
  }
  if (panel.remark) {
    c.fillStyle = colour("@muted", palette);
    c.font = `${13 * scale}px system-ui, sans-serif`;
    c.textAlign = "center";
    c.fillText(panel.remark, box.left + box.width / 2, box.top + box.height / 2);
  }
  c.restore();
}

// The arrays of a trace, unpacked once.
function opened(trace) {
  if (trace.open) return trace;
  trace.open = true;
  if (trace.kind === "shade") trace.ends = [unpack(trace.from), unpack(trace.to)];
  else if (trace.kind === "matrix") trace.cells = unpack(trace.values);
  else if (trace.kind !== "area") trace.path = [unpack(trace.x), unpack(trace.y)];
  if (trace.error) trace.bars = unpack(trace.error);
  return trace;
}

function tablesOf(trace) {
  if (trace.kind === "area") return table(unpack(trace.x), unpack(trace.high), unpack(trace.low));
  if (trace.kind === "line" || trace.kind === "markers") return table(...trace.path);
  return null;
}

function bounds(values) {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (v !== null && isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
  return low > high ? [0, 1] : [low, high];
}

function chart(holder, figure, panel, last, palette, width, height, pixels, mates) {
  const traces = panel.traces.map(opened);
  const shown = (_, v) => v === null || v === undefined ? "" : number(v);
  const series = [{ label: figure.x.title, value: shown, class: "quiet" }], tables = [], bands = [];
  for (const t of traces) {
    const own = tablesOf(t);
    if (!own) continue;
    tables.push(own);
    const ink = colour(t.colour, palette);
    const common = { label: t.name, value: shown, points: { show: false }, spanGaps: false };
    if (t.kind === "area") {
      bands.push({ series: [series.length, series.length + 1], fill: ink });
      const edge = { ...common, stroke: t.edge ? ink : "transparent", width: t.edge || 0 };
      series.push({ ...edge, class: t.legend ? undefined : "quiet", fill: undefined, legend: ink },
                  { ...edge, class: "quiet" });
    } else {
      const paths = t.kind === "markers" ? () => null : t.steps ? uPlot.paths.stepped({ align: 0 }) : undefined;
      series.push({ ...common, paths, stroke: ink, width: t.width || 1, dash: DASHES[t.dash || ""],
                    class: t.legend === false || !t.name ? "quiet" : undefined });
    }
  }
  const all = traces.flatMap((t) => t.kind === "trail" ? [t.path] : []);
  let data = tables.length ? uPlot.join(tables) : [[0, 1]];
  let xRange = figure.x.range, yRange = panel.y.range;
  if (!tables.length) {
    xRange = xRange || bounds(all.flatMap((p) => p[0]));
    yRange = yRange || bounds(all.flatMap((p) => p[1]));
    data = [xRange.slice()];
  }
  const axis = (own, side, shown) => ({
    stroke: colour("@muted", palette), label: shown ? own.title : undefined, labelSize: 18, labelGap: 0, gap: 4,
    labelFont: "12px system-ui, sans-serif", font: "11px system-ui, sans-serif",
    grid: { stroke: own.bare ? "transparent" : colour("@grid", palette), width: 1 },
    ticks: { stroke: colour("@line", palette), width: 1, size: 4, show: !own.bare },
    size: side === "x" ? (shown ? 26 : 8) : 52,
    ...(own.hidden ? { show: false } : {}),
    ...(own.ticks ? { splits: () => own.ticks[0], values: () => own.ticks[1], filter: undefined } : {
      values: (u, marks) => side === "x" && !shown ? marks.map(() => "")
        : marks.map((v) => v === null ? "" : own.log ? (/^[125](e|$)/.test(String(+v.toPrecision(6)).replace(/^0\.0*|0+$|\./g, "")) ? number(v) : "") : number(v)),
    }),
  });
  let fitted;
  if (panel.equal && xRange && yRange && !panel.size) {
    const w = Math.max(width - 52, 50), h = Math.max(height - 44, 50);
    const unit = Math.max((xRange[1] - xRange[0]) / w, (yRange[1] - yRange[0]) / h) * 1.06 || 1;
    const mid = [(xRange[0] + xRange[1]) / 2, (yRange[0] + yRange[1]) / 2];
    fitted = [[mid[0] - unit * w / 2, mid[0] + unit * w / 2], [mid[1] - unit * h / 2, mid[1] + unit * h / 2]];
    [xRange, yRange] = fitted;
  }
  const shape = { width, height };
  const options = {
    ...shape,
    pxAlign: 0,
    padding: [8, 12, 0, 0],
    cursor: { drag: { x: !panel.equal, y: false, setScale: !panel.equal }, points: { show: false },
              sync: holder.dataset.link ? { key: holder.dataset.link } : undefined },
    legend: { live: !panel.equal && !panel.texts, show: series.slice(1).some((s) => s.class !== "quiet"),
              markers: { width: 0, fill: (u, i) => u.series[i].legend || u.series[i].stroke(u, i) } },
    scales: {
      x: { time: false, ...(xRange ? { range: (u, a, b) => u.zoomed ? [a, b] : xRange } : {}) },
      y: { distr: panel.y.log ? 3 : 1, ...(yRange ? { range: yRange } : {}) },
    },
    axes: [axis(figure.x, "x", last), axis(panel.y, "y", true)],
    series, bands,
    hooks: {
      drawClear: [(u) => paint(u, traces, palette, uPlot.pxRatio, true)],
      drawAxes: [(u) => rules(u, panel, palette, uPlot.pxRatio)],
      draw: [(u) => paint(u, traces, palette, uPlot.pxRatio, false)],
      setCursor: [(u) => readout(holder, u, panel, traces)],
      setScale: [(u, key) => follow(u, key, mates)],
      setSelect: [(u) => { if (u.select.width > 2) u.zoomed = true; }],
    },
  };
  const u = new uPlot(options, data, holder);
  u.over.addEventListener("dblclick", () => { u.zoomed = false; mates().forEach((m) => { m.zoomed = false; }); });
  return u;
}

// Time axes of one section move together, and those of the panels of one figure.
let moving = false;
function follow(u, key, mates) {
  if (key !== "x" || moving) return;
  moving = true;
  const { min, max } = u.scales.x;
  for (const mate of mates()) {
    if (mate !== u && mate.scales.x.min !== undefined && (mate.scales.x.min !== min || mate.scales.x.max !== max)) {
      mate.zoomed = Boolean(u.zoomed);
      mate.setScale("x", { min, max });
    }
  }
  moving = false;
}

// Names of points and cells under the pointer.
function readout(holder, u, panel, traces) {
  const line = holder.querySelector(".readout");
  if (!line) return;
  const { left, top } = u.cursor;
  if (left < 0) { line.textContent = "\u00a0"; return; }
  const x = u.posToVal(left, "x"), y = u.posToVal(top, "y");
  for (const t of traces) {
    if (t.kind === "matrix") {
      const n = t.names.length, j = Math.round(x), i = n - 1 - Math.round(y);
      if (i >= 0 && j >= 0 && i < n && j < n) {
        line.textContent = `${t.names[i]} · ${t.names[j]}: ${number(t.cells[i * n + j])}`;
        return;
      }
    } else if (t.texts) {
      let best = 12, text = "\u00a0";
      t.path[0].forEach((v, i) => {
        const away = Math.hypot(u.valToPos(v, "x") - left, u.valToPos(t.path[1][i], "y") - top);
        if (away < best) { best = away; text = `${t.texts[i]}: ${number(t.path[1][i])}`; }
      });
      line.textContent = text;
    }
  }
}

function draw(holder, palette, printed) {
  const figure = DRAWINGS[holder.dataset.figure];
  (charts.get(holder) || []).forEach((u) => u.destroy());
  holder.textContent = "";
  holder.style.height = "auto";
  const width = printed ? (holder.parentElement.className ? PRINT_WIDTH : PRINT_HALF) : Math.max(holder.clientWidth, 200);
  const mates = () => plots.filter((p) => p === holder || (holder.dataset.link && p.dataset.link === holder.dataset.link))
    .flatMap((p) => charts.get(p) || []);
  const made = figure.panels.map((panel, i) => {
    const square = panel.equal && Math.min(panel.height, width + 20);
    const height = (square || panel.height) * (printed && !panel.size ? PRINT_SHARE : 1);
    const last = i === figure.panels.length - 1;
    return chart(holder, figure, panel, last, palette, square && panel.size ? Math.min(width, square) : width, height, 1, mates);
  });
  charts.set(holder, made);
  if (figure.panels.some((p) => p.traces.some((t) => t.kind === "matrix" || t.texts))) {
    const line = document.createElement("p");
    line.className = "readout";
    line.textContent = "\u00a0";
    holder.append(line);
  }
}

const palette = () => PALETTES[dark.matches ? "dark" : "light"];

async function drawAll() {
  for (const holder of plots) {
    draw(holder, palette(), false);
    await new Promise((next) => setTimeout(next));  // let the browser handle events between figures
  }
  document.documentElement.dataset.drawn = "all";
}

function redrawAll(printed) {
  plots.forEach((holder) => draw(holder, printed ? PALETTES.light : palette(), printed));
}

let wide = window.innerWidth;
window.addEventListener("resize", () => {
  if (window.innerWidth === wide) return;
  wide = window.innerWidth;
  clearTimeout(window.redrawing);
  window.redrawing = setTimeout(() => redrawAll(false), 150);
});
dark.addEventListener("change", () => redrawAll(false));
window.addEventListener("beforeprint", () => redrawAll(true));
window.addEventListener("afterprint", () => redrawAll(false));
drawAll();
