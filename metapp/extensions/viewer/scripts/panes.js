// Panes: pictures that are compared stand in rectangles of one size, side by side, or above one another in a narrow view.
// Also false colours of errors, and their legends.

const GAP = 6;  // px between panes
const HEAT = [[0, 0, 4], [87, 16, 110], [188, 55, 84], [249, 142, 9], [252, 255, 164]];  // false colours of errors from 0 to the greatest, sRGB in 0 to 255
const HEAT_GLSL = `
const vec3 HEAT[5] = vec3[](${HEAT.map((rgb) => `vec3(${rgb.map((x) => (x / 255).toFixed(6)).join(", ")})`).join(", ")});
vec3 heat(float x) {
  float at = clamp(x, 0.0, 1.0) * 4.0;
  int i = min(int(at), 3);
  return mix(HEAT[i], HEAT[i + 1], at - float(i));
}`;

function heat(x) {
  const at = clamp(x, 0, 1) * (HEAT.length - 1), i = Math.min(Math.floor(at), HEAT.length - 2);
  return HEAT[i].map((low, c) => low + (at - i) * (HEAT[i + 1][c] - low));
}

// Return the grid in which `count` pictures of one shape, width over height, are largest: rectangles {x, y, width, height} in
// whole px. Above each picture `head` px are left for its label, below it `foot` px for its legend; a last row that is not
// full is centred.
function gridOf(count, width, height, { shape = 1, head = 0, foot = 0, gap = GAP } = {}) {
  let best = { size: 0 };
  for (let columns = 1; columns <= count; columns++) {
    const rows = Math.ceil(count / columns);
    const cell = [Math.floor((width - gap * (columns - 1)) / columns), Math.floor((height - gap * (rows - 1)) / rows) - head - foot];
    const size = Math.min(cell[0] / shape, cell[1]);
    if (size > best.size) best = { size, columns, rows, cell };
  }
  if (!best.size) return [];
  const { columns, rows, cell } = best;
  return Array.from({ length: count }, (_, i) => {
    const row = Math.floor(i / columns), missing = row === rows - 1 ? columns * rows - count : 0;
    const x = Math.floor((width - columns * cell[0] - gap * (columns - 1)) / 2 + (i % columns + missing / 2) * (cell[0] + gap));
    return { x, y: row * (cell[1] + head + foot + gap) + head, width: cell[0], height: cell[1] };
  });
}

// Return the height of the strip that labels need, whose texts are wrapped to the width of a pane.
function headOf(labels, width) {
  labels.forEach((label) => { label.style.maxWidth = `${Math.max(width - 8, 40)}px`; });
  return Math.max(0, ...labels.map((label) => (label.hidden ? 0 : label.offsetHeight + 4)));
}

const percent = (x) => `${parseFloat((100 * x).toPrecision(3))} %`;

// A canvas with a colour scale from 0 to `most`: `title` says what the colours stand for, `told` which numbers were found.
const LEGEND = 46;  // height in px
function drawLegend(canvas, width, { most, title, told = "", text = percent }) {
  const ratio = devicePixelRatio, g = canvas.getContext("2d"), wide = Math.min(width - 28, 320), left = 14;
  Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(LEGEND * ratio) });
  Object.assign(canvas.style, { width: `${width}px`, height: `${LEGEND}px` });
  g.scale(ratio, ratio);
  const ramp = g.createLinearGradient(left, 0, left + wide, 0);
  for (let i = 0; i <= 16; i++) ramp.addColorStop(i / 16, `rgb(${heat(i / 16).map(Math.round)})`);
  g.fillStyle = ramp;
  g.fillRect(left, 2, wide, 9);
  Object.assign(g, { fillStyle: "#c9ccd2", font: "11px system-ui, sans-serif", textBaseline: "top" });
  const ticks = wide > 180 ? 4 : wide > 130 ? 2 : 1;
  for (let i = 0; i <= ticks; i++) {
    g.fillRect(left + i * wide / ticks - 0.5, 11, 1, 3);
    g.textAlign = i === 0 ? "left" : i === ticks ? "right" : "center";
    g.fillText(`${i === ticks ? "\u2265 " : ""}${text(most * i / ticks)}`, left + i * wide / ticks + (i === 0 ? -4 : i === ticks ? 8 : 0), 15);
  }
  g.textAlign = "left";
  g.fillText([title, told].filter(Boolean).join(": "), left - 4, 31, width - 14);
  canvas.setAttribute("aria-label", `${title}: colours from 0 to ${text(most)}${told ? `; ${told}` : ""}`);
}
