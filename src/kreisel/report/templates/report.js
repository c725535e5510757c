"use strict";
// Colours are written @name or @name/opacity in the figures, so that one figure serves light and dark.
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const plots = [...document.querySelectorAll(".plot")];
const PRINT_WIDTH = 680;
const PRINT_SHARE = 0.8;  // of the height on screen: two stacks of panels fill a page

function painted(node, palette) {
  if (typeof node === "string") {
    if (node[0] !== "@") return node;
    const [name, opacity] = node.slice(1).split("/");
    return opacity ? `rgba(${palette[name]},${opacity})` : `rgb(${palette[name]})`;
  }
  if (Array.isArray(node)) return node.map((part) => painted(part, palette));
  if (node === null || typeof node !== "object") return node;
  return Object.fromEntries(Object.entries(node).map(([key, part]) => [key, painted(part, palette)]));
}

function draw(plot, palette, width) {
  const figure = painted(DRAWINGS[plot.dataset.figure], palette);
  if (plot.parentElement.classList.contains("square")) {
    figure.layout.height = Math.min(figure.layout.height, (width || plot.clientWidth) + 60);
  } else if (width) {
    figure.layout.height *= PRINT_SHARE;
  }
  if (width) figure.layout.width = width;
  plot.style.height = `${figure.layout.height}px`;
  const config = { responsive: !width, displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
  return Plotly.react(plot, figure.data, figure.layout, config);
}

function screenPalette() {
  return PALETTES[dark.matches ? "dark" : "light"];
}

// Time axes of one section move together.
let moving = false;
function link(plot) {
  const mates = plots.filter((other) => other !== plot && plot.dataset.link && other.dataset.link === plot.dataset.link);
  plot.on("plotly_relayout", (change) => {
    if (moving || !mates.length) return;
    let update = null;
    if ("xaxis.range[0]" in change) update = { "xaxis.range": [change["xaxis.range[0]"], change["xaxis.range[1]"]] };
    else if (change["xaxis.autorange"]) update = { "xaxis.autorange": true };
    if (!update) return;
    moving = true;
    Promise.all(mates.map((mate) => Plotly.relayout(mate, update))).finally(() => { moving = false; });
  });
}

async function drawAll() {
  for (const plot of plots) {
    await draw(plot, screenPalette());
    link(plot);
    await new Promise((next) => setTimeout(next));  // let the browser handle events between figures
  }
  document.documentElement.dataset.drawn = "all";
}

dark.addEventListener("change", () => plots.forEach((plot) => draw(plot, screenPalette())));
window.addEventListener("beforeprint", () => plots.forEach((plot) => draw(plot, PALETTES.light, PRINT_WIDTH)));
window.addEventListener("afterprint", () => plots.forEach((plot) => draw(plot, screenPalette())));
drawAll();
