// The program of the page: it makes maps of a photo by onnxruntime-web. The runtime and the model are text in scripts,
// since browsers forbid a page from disk to read other files.
"use strict";

const MAPS = Array.from(document.querySelectorAll("#maps canvas"), (canvas) => canvas.id);
const COLOURS = ["diffuse", "specular"];  // linear RGB, shown as sRGB
const LARGEST = 4096;  // px of a photo's square that is read

const find = (id) => document.getElementById(id);
const toLinear = (s) => (s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4);
const toSrgb = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
const LINEAR = Float32Array.from({ length: 256 }, (_, value) => toLinear(value / 255));

let photo = null;  // {name, bitmap} of the photo that is open
let maps = null;  // {name, side, values: {map: Float32Array [C, side, side]}} of the photo that is shown
let runs = Promise.resolve();  // a session runs one photo at a time

function say(text, problem = false) {
  find("said").textContent = text;
  find("said").classList.toggle("problem", problem);
}

// Return the bytes that a script beside the page holds, and free its text.
async function unpacked(name) {
  const answer = await fetch(`data:application/gzip;base64,${globalThis.packed[name]}`);
  delete globalThis.packed[name];
  return new Response(answer.body.pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

async function load() {
  if (!globalThis.ort || !["wasm", "module", "model"].every((name) => globalThis.packed?.[name])) {
    throw new Error("ort.js, runtime.js or model.js is missing or damaged, expected all three beside this page; copy the whole folder.");
  }
  ort.env.wasm.numThreads = 1;  // more of them need headers that only a server sends
  ort.env.wasm.wasmBinary = await unpacked("wasm");
  const module = new Blob([await unpacked("module")], { type: "text/javascript" });
  ort.env.wasm.wasmPaths = { mjs: URL.createObjectURL(module) };
  const session = await ort.InferenceSession.create(new Uint8Array(await unpacked("model")), { executionProviders: ["wasm"] });
  say("Ready.");
  return session;
}

// Return means over `count` equal intervals of each row of values [rows, length, 3], transposed to [count, rows, 3].
function intervals(values, rows, length, count) {
  const result = new Float32Array(count * rows * 3), scale = length / count;
  for (let i = 0; i < count; i++) {
    const first = i * scale, end = (i + 1) * scale;
    for (let j = Math.floor(first); j < Math.min(Math.ceil(end - 1e-9), length); j++) {
      const share = (Math.min(end, j + 1) - Math.max(first, j)) / scale;
      for (let row = 0; row < rows; row++) {
        const from = 3 * (row * length + j), to = 3 * (i * rows + row);
        for (let c = 0; c < 3; c++) result[to + c] += share * values[from + c];
      }
    }
  }
  return result;
}

// Return the central square of a photo as input of the model, [3, side, side], sRGB. Pixels are means over areas in
// linear light, as metapp reads photos.
function input(bitmap, side) {
  const own = Math.min(bitmap.width, bitmap.height), size = Math.min(Math.max(own, side), LARGEST);
  const canvas = Object.assign(document.createElement("canvas"), { width: size, height: size });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, (bitmap.width - own) >> 1, (bitmap.height - own) >> 1, own, own, 0, 0, size, size);
  const { data } = context.getImageData(0, 0, size, size), linear = new Float32Array(size * size * 3);
  for (let i = 0; i < size * size; i++) for (let c = 0; c < 3; c++) linear[3 * i + c] = LINEAR[data[4 * i + c]];
  const means = size === side ? linear : intervals(intervals(linear, size, size, side), side, size, side);
  const result = new Float32Array(3 * side * side);
  for (let i = 0; i < side * side; i++) for (let c = 0; c < 3; c++) result[c * side * side + i] = toSrgb(means[3 * i + c]);
  return result;
}

// Show values [1 or 3, side, side] from 0 to 1 on a canvas.
function show(canvas, values, side, display) {
  const count = side * side, grey = values.length === count, picture = new ImageData(side, side);
  for (let i = 0; i < count; i++) {
    for (let c = 0; c < 3; c++) picture.data[4 * i + c] = Math.round(255 * display(values[grey ? i : c * count + i]));
    picture.data[4 * i + 3] = 255;
  }
  Object.assign(canvas, { width: side, height: side }).getContext("2d").putImageData(picture, 0, 0);
}

function showMaps({ side, values }) {
  for (const name of MAPS) {
    const display = COLOURS.includes(name) ? (x) => toSrgb(Math.min(Math.max(x, 0), 1)) : name === "normal" ? (x) => 0.5 * x + 0.5 : (x) => x;
    show(find(name), values[name], side, display);
  }
  document.querySelectorAll("button").forEach((button) => { button.disabled = false; });
}

async function run() {
  const session = await ready, { name, bitmap } = photo, side = Number(find("side").value);
  const values = input(bitmap, side);
  find("photo").hidden = false;
  show(find("photo"), values, side, (x) => x);
  say(`${name}: computes its maps.`);
  await new Promise((shown) => setTimeout(shown, 50));  // the page stands still while the session runs
  const start = performance.now();
  const results = await session.run({ photo: new ort.Tensor("float32", values, [1, 3, side, side]) });
  maps = { name, side, values: Object.fromEntries(MAPS.map((map) => [map, results[map].data])) };
  showMaps(maps);
  say(`${name}: maps of ${side} x ${side} px in ${((performance.now() - start) / 1000).toFixed(1)} s.`);
}

// Run the open photo after the one that runs; a problem is shown, and does not keep the next photo from running.
function next() {
  runs = runs.then(run).catch((error) => say(`${photo?.name}: ${error.message ?? error}`, true));
  return runs;
}

async function open(file) {
  let bitmap;
  try {
    bitmap = await createImageBitmap(file);
  } catch {
    say(`${file.name}: no picture that this browser reads, expected a JPEG or PNG; convert it.`, true);
    return;
  }
  photo = { name: file.name, bitmap };
  await next();
}

async function save(name) {
  const picture = await new Promise((done) => { find(name).toBlob(done, "image/png"); });
  const link = document.createElement("a"), address = URL.createObjectURL(picture);
  Object.assign(link, { href: address, download: `${maps.name.replace(/\.[^.]*$/, "")}_${name}.png` }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60000);
}

find("file").addEventListener("change", ({ target }) => { if (target.files[0]) open(target.files[0]); });
find("side").addEventListener("change", () => { if (photo) next(); });
find("all").addEventListener("click", async () => { for (const name of MAPS) await save(name); });
document.querySelectorAll("[data-map]").forEach((button) => button.addEventListener("click", () => save(button.dataset.map)));
document.addEventListener("dragover", (event) => { event.preventDefault(); find("drop").classList.add("over"); });
document.addEventListener("dragleave", () => find("drop").classList.remove("over"));
document.addEventListener("drop", (event) => {
  event.preventDefault();
  find("drop").classList.remove("over");
  const [file] = event.dataTransfer.files;
  if (file) open(file);
});

const ready = load();
ready.catch((error) => say(error.message ?? String(error), true));
