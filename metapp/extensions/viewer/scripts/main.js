// The page: which group is open, the loop that draws, and what tests and other programs call (window.metapp).

const page = {
  header: document.querySelector("header"), nav: document.querySelector("nav"), stage: document.getElementById("stage"),
  form: document.getElementById("controls"), footer: document.querySelector("footer"), problem: document.querySelector(".problem"),
};
let viewer = null, controls = null, dirty = false, busy = false, drawn = 0, opened = 0, index = 0;

function say(text) { page.footer.querySelector(".said").textContent = text; }
function sayNumbers(text) { page.footer.querySelector(".numbers").textContent = text; }

function tell(problem) {
  page.problem.hidden = !problem;
  page.problem.textContent = problem;
}

function fail(error) {
  closeView();
  tell(`This view cannot be drawn: ${error.message}`);
  console.error(error);
}

function closeView() { viewer?.close(); viewer = null; }

async function openGroup(wanted) {
  index = wanted;
  const group = DATA.groups[index], turn = ++opened, before = viewer?.kind === group.kind ? { ...controls.settings } : {};
  closeView();
  tell("");
  page.header.querySelector("h1").textContent = group.title;
  document.title = `${group.title}: ${DATA.title}`;
  captions(group);
  sayNumbers("");
  mark(page.nav, index);
  const next = new VIEWERS[group.kind](page.stage, group, () => { dirty = true; });
  next.lost = () => tell("The browser stopped WebGL, as drawing took too long or the page was left. The view comes back when WebGL does; if it stays away, load the page anew.");
  next.restored = () => openGroup(wanted);  // the contents of the GPU's memory are lost
  try {
    await next.open();
    if (turn !== opened) return next.close();  // another group was opened meanwhile
    const made = new Controls(page.form, next.controls(), (name) => { next.changed(name); dirty = true; });
    next.settings = made.settings;
    next.set = (name, value) => made.set(name, value);
    next.kind = group.kind;
    [viewer, controls] = [next, made];
    resize();
    for (const { name, options } of made.controls) {  // settings stay as they were, where this viewer has them
      if (name in before && (!options || options.some(([value]) => value === before[name]))) made.set(name, before[name]);
    }
  } catch (error) {
    next.close();
    if (turn === opened) fail(error);
    throw error;
  }
}

function captions(group) {
  page.header.querySelector(".caption").textContent = group.fits.length === 1
    ? [group.fits[0].label, group.fits[0].caption].filter(Boolean).join(": ") : group.section;
}

function resize() { viewer?.resize(); dirty = true; }

function frame() {
  if (viewer && page.problem.hidden && (dirty || busy)) {
    dirty = false;
    try { busy = viewer.draw(); drawn += 1; } catch (error) { busy = false; fail(error); }
  }
  requestAnimationFrame(frame);
}

// Change by keys what is compared, if the viewer can compare, and the exposure.
function compare(show) {
  const { options } = controls?.controls.find(({ name, when }) => name === "show" && (!when || when(controls.settings))) ?? {};
  const has = (value) => options?.some(([each]) => each === value), usual = ["beside", "all"].find(has);
  const wanted = show === "beside" ? usual : show === controls?.settings.show ? usual : show;
  if (has(wanted)) controls.set("show", wanted);
}
function expose(stops) {
  const control = controls?.controls.find(({ name }) => name === "exposure");
  if (control) controls.set("exposure", clamp(controls.settings.exposure + stops, control.min, control.max));
}

async function png() {
  viewer.draw();
  return viewer.png().toDataURL("image/png");
}

// Return the picture of the viewer with the labels, plots and lines that lie over it.
async function labelled() {
  viewer.draw();
  const seen = viewer.png(), box = seen.getBoundingClientRect(), ratio = seen.width / box.width;
  const canvas = make("canvas", { width: seen.width, height: seen.height }), g = canvas.getContext("2d");
  g.drawImage(seen, 0, 0);
  g.scale(ratio, ratio);
  for (const each of [".wipe", ".plot", ".label"].flatMap((kind) => [...viewer.element.querySelectorAll(kind)])) {
    const { left, top, width, height } = each.getBoundingClientRect(), [x, y] = [left - box.left, top - box.top];
    if (each.hidden) continue;
    if (each.matches(".plot")) { if (!each.matches(".scale")) drawBox(g, x, y, width, height, "#101114e8"); g.drawImage(each, x, y, width, height); }
    else if (each.matches(".wipe")) { g.fillStyle = "#fff"; g.fillRect(x + 6, y, 1, height); }
    else { drawBox(g, x, y, width, height, "#000a"); drawText(g, each, x, y); }
  }
  return canvas.toDataURL("image/png");
}

function drawBox(g, x, y, width, height, colour) {
  g.fillStyle = colour;
  g.beginPath();
  g.roundRect(x, y, width, height, 4);
  g.fill();
}

// Return the text of an element, with the browser's own line breaks.
function drawText(g, element, x, y) {
  const range = document.createRange(), text = element.firstChild, box = element.getBoundingClientRect(), lines = [];
  for (let i = 0; i < text.length; i++) {
    range.setStart(text, i); range.setEnd(text, i + 1);
    const { left, top } = range.getBoundingClientRect(), last = lines.at(-1);
    if (last && Math.abs(last.top - top) < 2) last.text += text.data[i];
    else lines.push({ left, top, text: text.data[i] });
  }
  const { font, color } = getComputedStyle(element);
  Object.assign(g, { font, fillStyle: color, textBaseline: "alphabetic", textAlign: "left" });
  for (const line of lines) g.fillText(line.text, x + line.left - box.left, Math.round(y + line.top - box.top + g.measureText(line.text).fontBoundingBoxAscent));
}

document.getElementById("save").addEventListener("click", async () => {
  if (viewer && page.problem.hidden) make("a", { href: await labelled(), download: `${document.querySelector("h1").textContent.replace(/[^\w.-]+/g, "_")}.png` }).click();
});
document.getElementById("options").addEventListener("click", ({ target }) => {
  target.setAttribute("aria-expanded", page.form.classList.toggle("open"));
  resize();
});
addEventListener("resize", resize);
list(page.nav, openGroup);
listen(page.nav, helpOf(document.getElementById("help")), { open: openGroup, index: () => index, compare, expose });
window.metapp = {
  ready: openGroup(0),
  open: openGroup,
  get index() { return index; },
  set: (name, value) => controls.set(name, value),
  png,
  labelled,
  get viewer() { return viewer; },
  get settings() { return controls.settings; },
  get drawn() { return drawn; },
  settled: async () => { do await new Promise((done) => { setTimeout(done, 30); }); while ((dirty || busy) && page.problem.hidden); },
};
window.metapp.ready.catch(() => {});
requestAnimationFrame(frame);
