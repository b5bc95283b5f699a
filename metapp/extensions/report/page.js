"use strict";
// Tables: a click on a heading sorts by its column, another one the other way round; what has no number comes last.
const numberOf = (text) => {
  const found = text.replaceAll(",", "").match(/-?\d+(\.\d+)?(e-?\d+)?/i);
  return text.trim() === "-" || !found ? NaN : parseFloat(found[0]);
};
for (const table of document.querySelectorAll("table.sortable")) {
  const headings = [...table.tHead.rows[0].cells];
  headings.forEach((heading, column) => heading.querySelector("button").addEventListener("click", () => {
    const up = heading.getAttribute("aria-sort") !== "ascending";
    headings.forEach((each) => each.setAttribute("aria-sort", "none"));
    heading.setAttribute("aria-sort", up ? "ascending" : "descending");
    const words = heading.classList.contains("left");
    const key = (row) => (words ? row.cells[column].textContent : numberOf(row.cells[column].textContent));
    const body = table.tBodies[0];
    const compare = (a, b) => {
      const [x, y] = [key(a), key(b)];
      if (words) return x.localeCompare(y, undefined, { numeric: true }) * (up ? 1 : -1);
      if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) - Number.isNaN(y);
      return (x - y) * (up ? 1 : -1);
    };
    body.append(...[...body.rows].sort(compare));
  }));
}
// Pictures: a click shows the record behind one.
const records = JSON.parse(document.getElementById("records").textContent);
const dialog = document.getElementById("record");
for (const button of document.querySelectorAll("button.record")) {
  button.addEventListener("click", () => {
    const { of, row, task } = button.dataset;
    const { key, ...record } = records[of].records[row][task];
    const shown = document.getElementById("shown");
    const picture = button.querySelector("img").cloneNode();
    const text = document.createElement("pre");
    text.textContent = JSON.stringify({ ...record, key, settings: records[of].settings[key] }, null, 2);
    const title = document.createElement("h3");
    title.textContent = `${task}: ${row}`;
    shown.replaceChildren(title, picture, text);
    dialog.showModal();
  });
}
dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((each) => { each.open = true; }));
