// What all scripts of a page share: its data, colours of the style sheet, numbers for people.

const DATA = JSON.parse(document.getElementById("data").textContent);

/** Colours and fonts of the style sheet, which change with the colour scheme. */
const theme = {
  cache: new Map(),
  get(name) {
    if (!this.cache.has(name)) {
      this.cache.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
    }
    return this.cache.get(name);
  },
  /** Call a function whenever the colour scheme has changed. */
  follow(paint) {
    this.followers.push(paint);
  },
  followers: [],
};
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  theme.cache.clear();
  for (const paint of theme.followers) paint();
});

/** Call a function now and whenever the colour scheme or the size of an element changes. */
function keepPainted(element, paint) {
  theme.follow(paint);
  new ResizeObserver(paint).observe(element);
}

/** Numbers for people: as many digits as matter, a real minus sign. */
function shown(value, digits = 4) {
  if (value === null || !Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-3 || size >= 10 ** Math.max(6, digits)) ? value.toExponential(digits - 1) : value.toPrecision(digits);
  return (text.includes("e") ? text.replace("e+", "e") : String(Number(text))).replaceAll("-", "−");
}

/** An element with attributes and children; texts stay texts. */
function make(tag, attributes = {}, ...children) {
  const svg = ["svg", "path", "g", "rect", "text", "circle", "line", "title"].includes(tag);
  const element = svg ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

// In a frame without an address (a cell of a notebook) a link into the page would lead to that of the notebook.
if (location.protocol === "about:")
  document.addEventListener("click", (event) => {
    const target = document.getElementById(event.target.closest('a[href^="#"]')?.hash.slice(1) ?? "");
    if (!target) return;
    event.preventDefault();
    target.scrollIntoView();
  });
