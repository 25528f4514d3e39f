// Buttons that copy or save what a card shows: its numbers as CSV, its picture as PNG.

import { make } from "clothfit/drawing";

const SCALE = 3;  // pixels of a saved chart for each of its units
const STYLES = ["fill", "stroke", "stroke-width", "stroke-dasharray", "stroke-linejoin", "opacity", "font-size",
                "font-family", "text-anchor", "font-variant-numeric"];

/** Rows of cells as CSV (RFC 4180). What a spreadsheet would take for a formula is given a leading apostrophe. */
export function csv(rows) {
  const cell = (value) => {
    let text = value === null || value === undefined ? "" : String(value);
    if (typeof value === "string" && /^[=+\-@\t]/.test(text) && !/^-?[\d.]+(e[+-]?\d+)?$/i.test(text)) text = `'${text}`;
    return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return rows.map((row) => row.map(cell).join(",")).join("\r\n") + "\r\n";
}

/** Offer an address to the browser as a file. */
function save(address, name) {
  const link = make("a", { href: address, download: name });
  document.body.append(link);
  link.click();
  link.remove();
}

function saveText(text, name) {
  const address = URL.createObjectURL(new Blob(["\ufeff", text], { type: "text/csv;charset=utf-8" }));
  save(address, name);
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/** Put text where paste finds it; returns whether that went well. */
async function copy(text) {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    const field = make("textarea", { class: "unseen", "aria-hidden": "true", tabindex: "-1" });
    field.value = text;
    document.body.append(field);
    field.select();
    const done = document.execCommand("copy");
    field.remove();
    return done;
  }
}

/** A chart as a PNG: a copy of it that carries its styles, drawn on a canvas over the colour of the card. */
async function pictureOf(chart) {
  const copied = chart.cloneNode(true), [, , width, height] = chart.getAttribute("viewBox").split(" ").map(Number);
  const own = [chart, ...chart.querySelectorAll("*")], theirs = [copied, ...copied.querySelectorAll("*")];
  own.forEach((element, i) => {
    const style = getComputedStyle(element);
    theirs[i].setAttribute("style", STYLES.map((name) => `${name}:${style.getPropertyValue(name)}`).join(";"));
  });
  copied.setAttribute("width", SCALE * width);
  copied.setAttribute("height", SCALE * height);
  copied.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  const image = new Image();
  image.src = `data:image/svg+xml;charset=utf-8,${encodeURIComponent(new XMLSerializer().serializeToString(copied))}`;
  await image.decode();
  return onGround(image, SCALE * width, SCALE * height, chart);
}

/** A picture over the colour of the card that it is in. */
function onGround(image, width, height, element) {
  const canvas = Object.assign(document.createElement("canvas"), { width, height }), pen = canvas.getContext("2d");
  pen.fillStyle = getComputedStyle(element.closest(".card") ?? document.body).backgroundColor;
  pen.fillRect(0, 0, width, height);
  pen.drawImage(image, 0, 0, width, height);
  return canvas;
}

/** Save a chart, a map or what a canvas shows as PNG. */
export async function savePicture(element, name) {
  const canvas = element.matches("canvas") ? onGround(element, element.width, element.height, element) : await pictureOf(element);
  save(canvas.toDataURL("image/png"), `${name}.png`);
}

/** The buttons of a card: `rows()` are those of its CSV file, `picture` is an element to save, or null. */
export function buttons(name, rows, picture = null) {
  const said = make("span", { class: "unseen", role: "status" });
  const button = (text, title, act) => {
    const made = make("button", { type: "button", class: "tool", title, "aria-label": title }, text);
    made.addEventListener("click", act);
    return made;
  };
  const found = [];
  if (rows) {
    const tabbed = () => rows().map((row) => row.join("\t")).join("\n");
    const copied = button("Copy", `Copy the numbers: ${name}`, async () => {
      const done = await copy(tabbed());
      copied.textContent = done ? "Copied" : "No access";
      said.textContent = done ? "copied" : "the browser does not allow it";
      setTimeout(() => { copied.textContent = "Copy"; said.textContent = ""; }, 1500);
    });
    found.push(copied, button("CSV", `Save the numbers as CSV: ${name}`, () => saveText(csv(rows()), `${name}.csv`)));
  }
  if (picture) found.push(button("PNG", `Save the picture as PNG: ${name}`, () => savePicture(picture, name)));
  return make("span", { class: "tools" }, ...found, said);
}
