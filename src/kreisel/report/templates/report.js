"use strict";
// Draws the figures of a page with uPlot. A figure is a stack of panels over one horizontal axis; kinds of traces:
// line, markers, area (between two curves), shade (intervals of x), trail (any direction), matrix (coloured cells).
// Colours are written @name or @name/opacity, so that one figure serves light and dark.
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const plots = [...document.querySelectorAll(".plot")];
const paper = window.matchMedia("print");
const charts = new Map();  // of each plot, its panels
// Sizes in pixels: those of letters, of the axes, and of the share of a panel's height; on paper also the widths.
const SCREEN = { font: 11, title: 12, x: 26, y: 48, label: 18, share: 1 };
const PAPER = { font: 9, title: 9, x: 17, y: 40, label: 13, share: 0.55, width: 690, half: 336, square: 430 };
const TOP = 8, RIGHT = 12, STUB = 8;  // room above and to the right of a panel, and below one that is not the last
const FAMILY = "system-ui, sans-serif";
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

// Round values from low to high, at least two, with their distance; at most as many as there is room for.
function round(low, high, most) {
  const count = (step) => Math.floor(high / step + 1e-9) - Math.ceil(low / step - 1e-9) + 1;
  let chosen = 0;
  for (let power = Math.ceil(Math.log10(high - low)); power > -18; power--) {
    for (const k of [5, 2, 1]) {
      const step = k * 10 ** power, found = count(step);
      if (found >= 2 && (found <= most || !chosen)) chosen = step;
      if (chosen && found > most) power = -Infinity;
    }
  }
  const first = Math.ceil(low / chosen - 1e-9);
  return [Array.from({ length: count(chosen) }, (_, i) => +((first + i) * chosen).toPrecision(12)), chosen];
}

// Round values of a logarithmic axis: 1, 2 and 5 of every decade, or 1 of some of them.
function decades(low, high, most) {
  const a = Math.floor(Math.log10(low)), b = Math.ceil(Math.log10(high));
  const own = (digits, every) => {
    const out = [];
    for (let power = a - a % every; power <= b; power += every) out.push(...digits.map((k) => +`${k}e${power}`));
    return out.filter((v) => v >= low && v <= high);
  };
  for (const found of [own([1, 2, 5], 1), own([1], 1), own([1], 2), own([1], 3)]) {
    if (found.length >= 2 && found.length <= Math.max(most, 2)) return found;
  }
  const every = own([1, 2, 3, 4, 5, 6, 7, 8, 9], 1);
  return every.length >= 2 ? every : round(low, high, most)[0];
}

// The ticks of an axis that has none of its own: values, and texts with as many digits as their distance asks for.
function ticksOf(own, low, high, room, gap) {
  if (!(high > low) || !isFinite(high - low)) return [[low], [number(low)]];
  const most = Math.max(2, Math.floor(room / gap));
  if (own.log) {
    const values = decades(low, high, most);
    return [values, values.map(number)];
  }
  const [values, step] = round(low, high, most);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const long = digits > 4 || Math.max(Math.abs(low), Math.abs(high)) >= 1e6;
  const text = (v) => v.toFixed(digits).replace(/^-(?=0\.?0*$)/, "").replace("-", "−");
  return [values, values.map(long ? number : text)];
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
        const k = t.path[0].length - 1, x = px(t.path[0][k]) + 4 * scale, y = py(t.path[1][k]) - 4 * scale;
        c.font = `${(printed ? PAPER : SCREEN).title * scale}px ${FAMILY}`;
        c.setLineDash([]);
        c.lineJoin = "round";
        c.lineWidth = 3 * scale;
        c.strokeStyle = colour("@ground/0.8", palette);  // letters stay readable above lines
        c.strokeText(t.label, x, y);
        if (t.colour === "@grid") c.fillStyle = colour("@muted", palette);
        c.fillText(t.label, x, y);
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
    c.font = `${13 * scale}px ${FAMILY}`;
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

// A title in letters so small that it fits beside its axis.
function titleFont(text, room, size) {
  const c = document.createElement("canvas").getContext("2d");
  c.font = `${size}px ${FAMILY}`;
  const wide = c.measureText(text).width;
  return `${Math.max(7, Math.floor(Math.min(1, room / wide) * size))}px ${FAMILY}`;  // uPlot wants a whole number
}

const longest = (texts) => Math.max(0, ...(texts || []).map((text) => String(text).length));

// Texts of given ticks, without those that would touch the one before.
function apart(at, texts, scale, font, vertical) {
  let end = -Infinity;
  return texts.map((text, i) => {
    const half = vertical ? 0.6 * font : 0.31 * font * (text.length + 1), place = scale * Math.abs(at[i] - at[0]);
    if (place - half < end) return "";
    end = place + half;
    return text;
  });
}

function axisOf(own, palette, sizes, room, vertical, shown) {
  const gap = vertical ? 2.2 * sizes.font : 5.5 * sizes.font;
  const found = (u, low, high) => own.ticks || ticksOf(own, low, high, room, gap);
  const scale = vertical ? "y" : "x";
  return {
    side: vertical ? 3 : 2, scale, space: 5, gap: 4, labelGap: 0, filter: (u, marks) => marks,
    stroke: colour("@muted", palette), font: `${sizes.font}px ${FAMILY}`,
    label: shown ? own.title : undefined, labelSize: sizes.label, labelFont: titleFont(own.title, room, sizes.title),
    size: vertical ? (u, texts) => Math.max(sizes.y, 12 + 0.62 * sizes.font * longest(texts)) : shown ? sizes.x : STUB,
    show: !own.hidden,
    grid: { stroke: own.bare ? "transparent" : colour("@grid", palette), width: 1 },
    ticks: { stroke: colour("@line", palette), width: 1, size: 4, show: !own.bare },
    splits: (u, i, low, high) => found(u, low, high)[0],
    values: (u) => {
      const { min, max } = u.scales[scale], [at, texts] = found(u, min, max);
      return !shown ? at.map(() => "") : own.ticks ? apart(at, texts, room / (max - min), sizes.font, vertical) : texts;
    },
  };
}

// The series of a panel's traces as uPlot wants them: their tables, and the areas between two of them.
function seriesOf(figure, traces, palette) {
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
      const dash = DASHES[t.dash || ""].map((d) => d * uPlot.pxRatio);
      const shape = t.kind === "markers" ? t.symbol || "disc" : t.dash || "line";
      series.push({ ...common, paths, stroke: ink, width: t.width || 1, dash,
                    class: t.legend === false || !t.name ? "quiet" : shape });
    }
  }
  return [series, tables, bands];
}

// The ranges of both axes that make one unit as long on either; across, down: the room.
function equalRanges(x, y, across, down) {
  const unit = Math.max((x[1] - x[0]) / across, (y[1] - y[0]) / down) || 1;
  const about = ([low, high], room) => [(low + high - unit * room) / 2, (low + high + unit * room) / 2];
  return [about(x, across), about(y, down)];
}

function chart(holder, figure, panel, last, palette, width, room, sizes, mates) {
  const traces = panel.traces.map(opened), [series, tables, bands] = seriesOf(figure, traces, palette);
  const all = traces.flatMap((t) => t.kind === "trail" ? [t.path] : []);
  const across = width - RIGHT - (panel.y.hidden ? 0 : sizes.y + sizes.label);
  let data = tables.length ? uPlot.join(tables) : [[0, 1]];
  let xRange = figure.x.range, yRange = panel.y.range;
  if (!tables.length) {
    xRange = xRange || bounds(all.flatMap((p) => p[0]));
    yRange = yRange || bounds(all.flatMap((p) => p[1]));
    data = [xRange.slice()];
  }
  if (panel.equal && xRange && yRange && !panel.size) [xRange, yRange] = equalRanges(xRange, yRange, across, room);
  const options = {
    width, height: TOP + room + below(figure, last, sizes),
    pxAlign: 0,
    padding: [TOP, RIGHT, 0, 0],
    cursor: { drag: { x: !panel.equal, y: false, setScale: !panel.equal }, points: { show: false },
              sync: holder.dataset.link ? { key: holder.dataset.link } : undefined },
    legend: { live: !panel.equal && !panel.texts, show: series.slice(1).some((s) => s.class !== "quiet"),
              markers: { width: 0, fill: (u, i) => u.series[i].legend || u.series[i].stroke(u, i) } },
    scales: {
      x: { time: false, ...(xRange ? { range: (u, a, b) => u.zoomed ? [a, b] : xRange } : {}) },
      y: { distr: panel.y.log ? 3 : 1, ...(yRange ? { range: yRange } : {}) },
    },
    axes: [axisOf(figure.x, palette, sizes, across, false, last), axisOf(panel.y, palette, sizes, room, true, true)],
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

// Height of the horizontal axis of a panel.
function below(figure, last, sizes) {
  return figure.x.hidden ? 0 : last ? sizes.x + sizes.label : STUB;
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
  const figure = DRAWINGS[holder.dataset.figure], sizes = printed ? PAPER : SCREEN, n = figure.panels.length;
  (charts.get(holder) || []).forEach((u) => u.destroy());
  holder.textContent = "";
  holder.style.height = "auto";
  const onPaper = holder.parentElement.className ? PAPER.width : PAPER.half;
  const whole = printed ? onPaper : Math.max(holder.clientWidth, 200);
  const link = holder.dataset.link;
  const mates = () => plots.filter((p) => p === holder || (link && p.dataset.link === link))
    .flatMap((p) => charts.get(p) || []);
  const beside = TOP + (below(figure, true, sizes) + (n - 1) * below(figure, false, sizes)) / n;  // panels have equal room
  const made = figure.panels.map((panel, i) => {
    const own = panel.size ? Math.min(printed ? PAPER.square : panel.height, whole + 20) : panel.height * sizes.share;
    const width = panel.size ? Math.min(whole, own) : whole;
    return chart(holder, figure, panel, i === n - 1, palette, width, Math.max(own - beside, 40), sizes, mates);
  });
  charts.set(holder, made);
  if (figure.panels.some((p) => p.traces.some((t) => t.kind === "matrix" || t.texts))) {
    const line = document.createElement("p");
    line.className = "readout";
    line.textContent = "\u00a0";
    holder.append(line);
  }
}

const palette = () => PALETTES[dark.matches && !printed ? "dark" : "light"];

let printed = paper.matches;  // whether it is drawn for paper
async function drawAll() {
  for (const holder of plots) {
    draw(holder, palette(), printed);
    await new Promise((next) => setTimeout(next));  // let the browser handle events between figures
  }
  reachable();
  document.documentElement.dataset.drawn = "all";
}

function redrawAll(onPaper) {
  printed = onPaper;
  plots.forEach((holder) => draw(holder, palette(), onPaper));
  reachable();
}

// What is wider than the page can be scrolled by keys, too.
function reachable() {
  for (const part of document.querySelectorAll(".scroll, pre")) {
    if (part.scrollWidth > part.clientWidth + 1) part.tabIndex = 0;
    else part.removeAttribute("tabindex");
  }
}

let wide = window.innerWidth;
window.addEventListener("resize", () => {
  if (window.innerWidth === wide || printed) return;
  wide = window.innerWidth;
  clearTimeout(window.redrawing);
  window.redrawing = setTimeout(() => redrawAll(printed), 150);
});
dark.addEventListener("change", () => { if (!printed) redrawAll(false); });
paper.addEventListener("change", () => { if (paper.matches !== printed) redrawAll(paper.matches); });
window.addEventListener("beforeprint", () => { if (!printed) redrawAll(true); });
window.addEventListener("afterprint", () => { if (printed) redrawAll(false); });
drawAll();
