// The list of fits with their thumbnails, keys of the whole page, and the help that explains them.

const KEYS = [
  ["\u2191 \u2193", "the fit before or after this one; Home and End: the first and last"],
  ["s", "side by side"], ["a", "side by side, with the difference"], ["d", "difference in false colours"],
  ["w", "wipe; again: back to side by side"], ["r", "reference alone"], ["f", "fit alone"],
  ["[ ]", "exposure, half a stop down or up"],
  ["Tab", "to the controls, the lamp, the wipe and the pictures"],
  ["\u2190 \u2192 \u2191 \u2193 on the lamp", "move it by 5\u00b0, with Shift by 1\u00b0"],
  ["\u2190 \u2192 on the wipe", "move it by 1 %, with Shift by 10 %; Home and End: to an edge"],
  ["\u2190 \u2192 \u2191 \u2193 on shapes", "turn them; + and \u2212: nearer or farther; 0: from the front again"],
  ["\u2190 \u2192 \u2191 \u2193 on pictures", "move them; + and \u2212: zoom; 0: as large as fits; 1: 100 %"],
  ["\u2190 \u2192 \u2191 \u2193 on maps as in metapp's picture", "move them, or the lamp of photos that are relit; + and \u2212: zoom; 0: all"],
  ["?", "this help; Esc closes it"],
];
const MODES = { s: "beside", a: "all", d: "difference", w: "wipe", r: "reference", f: "fit" };

function list(nav, open) {
  if (DATA.groups.length < 2) return;
  let section = "";
  DATA.groups.forEach((group, i) => {
    if (group.section !== section) nav.append(make("h2", { textContent: section = group.section }));
    const { thumbnail } = group.fits[0], picture = thumbnail ? make("img", { src: thumbnail, alt: "" }) : "";
    nav.append(make("button", { type: "button", onclick: () => open(i) }, picture, make("span", { textContent: group.title })));
  });
}

function mark(nav, index) {
  nav.querySelectorAll("button").forEach((each, i) => each.setAttribute("aria-current", i === index));
  nav.querySelector('[aria-current="true"]')?.scrollIntoView({ block: "nearest", inline: "nearest" });
}

// Open the help, by its button or its key.
function helpOf(button) {
  const rows = KEYS.map(([keys, does]) => make("tr", {}, make("th", { textContent: keys }), make("td", { textContent: does })));
  const close = make("button", { type: "button", textContent: "Close" }), dialog = make("dialog", { className: "help" },
    make("h2", { textContent: "Keys and pointer" }), make("table", {}, ...rows),
    make("p", { textContent: "Drag shapes to turn them, the yellow lamp to move it, pictures to move them; the wheel or two fingers zoom. All panes have the same camera, lamp, exposure and zoom." }), close);
  close.addEventListener("click", () => dialog.close());
  button.addEventListener("click", () => dialog.showModal());
  document.body.append(dialog);
  return dialog;
}

// Keys that count wherever the focus is, except in elements that take keys themselves.
function listen(nav, help, page) {
  document.addEventListener("keydown", (event) => {
    const { target, key } = event, typed = target.closest("input, select, textarea, dialog[open]"), own = typed || target.closest(".lamp, .wipe, canvas");
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    const moves = { ArrowDown: 1, ArrowUp: -1, ArrowRight: 1, ArrowLeft: -1 }[key], last = DATA.groups.length - 1;
    const to = moves ? clamp(page.index() + moves, 0, last) : { Home: 0, End: last }[key];
    if (key === "?" && !help.open) help.showModal();
    else if (key === "Escape" && help.open) help.close();
    else if (to !== undefined && !own && last > 0) {
      if (to !== page.index()) page.open(to);
      if (nav.contains(target)) nav.querySelectorAll("button")[to].focus();
    } else if (key in MODES && !typed) page.compare(MODES[key]);
    else if ("[]".includes(key) && !typed) page.expose(key === "[" ? -0.5 : 0.5);
    else return;
    event.preventDefault();
  });
}
