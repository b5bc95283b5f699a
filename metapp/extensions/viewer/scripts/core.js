"use strict";
// The parts that all viewers share: the page's data, its arrays and pictures, and controls.

const DATA = JSON.parse(document.getElementById("data").textContent);
const ARRAYS = { float16: Uint16Array, float32: Float32Array, uint8: Uint8Array };  // half floats as their bits

// Decode deflated text in base64 as {shape, values}.
async function numbersOf(spec) {
  const bytes = Uint8Array.from(atob(spec.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  return { shape: spec.shape, type: spec.type, values: new ARRAYS[spec.type](buffer) };
}

function fromHalf(bits) {
  const sign = bits & 0x8000 ? -1 : 1, exponent = (bits >> 10) & 31, fraction = bits & 1023;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  return exponent === 31 ? sign * Infinity : sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}

// Return an array of any type as Float32Array.
const floatsOf = (array) => (array.type === "float16" ? Float32Array.from(array.values, fromHalf) : Float32Array.from(array.values));

async function imageOf(address) {
  const image = new Image();
  image.src = address;
  await image.decode();
  return image;
}

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
const sharedArrays = new Map();
function shared(name) {  // return an array that several fits have in common
  if (!sharedArrays.has(name)) sharedArrays.set(name, numbersOf(DATA.shared[name]));
  return sharedArrays.get(name);
}

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key in element && key !== "list" && key !== "style") element[key] = value;
    else element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}

// Settings of a viewer by name, and the form that changes them.
//
// A control is {name, label, type, value, ...}: "choice" with options [[value, text], ...], "range" with min, max, step and
// optional text(value), "check", "action" with run(), "file" with accept and run(file), "note" with a text. `when(settings)`
// returns whether the control is shown.
class Controls {
  constructor(form, controls, changed) {
    this.form = form; this.controls = controls; this.changed = changed; this.settings = {};
    this.elements = new Map();
    for (const control of controls) if ("value" in control) this.settings[control.name] = control.value;
    form.replaceChildren(...controls.map((control) => this._element(control)));
    this.refresh();
  }

  set(name, value) {
    const { options } = this.controls.find((control) => control.name === name && "value" in control) ?? {};
    if (!(name in this.settings)) throw new Error(`no setting ${name}; there are ${Object.keys(this.settings)}`);
    if (options && !options.some(([each]) => each === value)) throw new Error(`no ${name} ${value}; there are ${options.map(([each]) => each)}`);
    this.settings[name] = value;
    this.refresh();
    this.changed(name);
  }

  refresh() {
    for (const control of this.controls) {
      const { box, input, text } = this.elements.get(control);
      box.hidden = control.when ? !control.when(this.settings) : false;
      const value = this.settings[control.name];
      if (control.type === "check") input.checked = value;
      else if (input && "value" in control) input.value = value;
      if (text) text.textContent = control.text ? control.text(value) : value;
    }
  }

  _element(control) {
    const put = (value) => this.set(control.name, value);
    const parts = { text: null, input: null };
    if (control.type === "choice") {
      const options = control.options.map(([value, text]) => make("option", { value, textContent: text }));
      parts.input = make("select", { onchange: () => put(parts.input.value) }, ...options);
    } else if (control.type === "range") {
      const { min, max, step } = control;
      parts.input = make("input", { type: "range", min, max, step, oninput: () => put(parseFloat(parts.input.value)) });
      parts.text = make("span");
    } else if (control.type === "check") {
      parts.input = make("input", { type: "checkbox", onchange: () => put(parts.input.checked) });
    } else if (control.type === "action") {
      parts.box = make("button", { type: "button", textContent: control.label, onclick: control.run });
    } else if (control.type === "file") {
      parts.input = make("input", { type: "file", accept: control.accept, onchange: () => parts.input.files.length && control.run(parts.input.files[0]) });
    } else {
      parts.box = make("p", { textContent: control.label });
    }
    parts.box ??= control.type === "check"
      ? make("label", {}, parts.input, ` ${control.label}`)
      : make("label", {}, make("span", { className: "name" }, make("span", { textContent: control.label }), parts.text ?? ""), parts.input);
    this.elements.set(control, parts);
    return parts.box;
  }
}

// A viewer shows the fits of a group side by side in an element of its own, all by the same settings and from the same place.
//
// A subclass defines `controls()`, `open()`, called before the first frame, `draw()`, which returns whether the picture still
// improves, `resize()`, `close()` and `png()`, which returns a canvas with the picture. The page gives the viewer `set(name,
// value)` once it is open, which controls follow, and `lost()` and `restored()` from the start: the viewer calls them when it
// cannot draw for now, and when it can again.
class Viewer {
  constructor(stage, group, redraw) {
    this.element = make("div", { className: "view" }); this.fits = group.fits; this.redraw = redraw;
    stage.append(this.element);
    this.settings = {};  // values of the controls
  }
  controls() { return []; }
  async open() {}
  draw() { return false; }
  resize() {}
  changed() {}
  get strip() { return true; }  // whether labels stand above pictures in place of over them
  close() { this.lost = this.restored = null; this.element.remove(); }
}

const VIEWERS = {};  // classes of viewers, by kind
