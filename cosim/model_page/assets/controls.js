// Controls of values: a slider with a number beside it, a number alone, a switch, a choice.

/** How many controls a folded panel of settings shows: those used last, at first the first sliders. */
const NEAR = 2;

class Controls {
  /** All controls inside an element, by the name in their `data-name`; `changed` is called after each change. */
  constructor(root, changed) {
    this.fields = new Map();
    this.changed = changed;
    for (const field of root.querySelectorAll("[data-name]")) this.add(field);
    this.near = [];
    const all = [...this.fields.values()];
    const first = [...all.filter(({ slider }) => slider), ...all.filter(({ slider }) => !slider)].slice(0, NEAR);
    for (const control of first.reverse()) this.use(control);
    this.fold(root.querySelector(".settings"));
  }

  /** Narrow windows show a panel of settings folded, over what it changes; its button opens it. */
  fold(panel) {
    const button = panel.querySelector(".fold");
    const show = (folded) => {
      panel.classList.toggle("folded", folded);
      button.setAttribute("aria-expanded", String(!folded));
      button.textContent = folded ? "All settings" : "Fewer settings";
    };
    button.addEventListener("click", () => show(!panel.classList.contains("folded")));
    show(true);
  }

  /** Put a control among those that a folded panel shows. */
  use(control) {
    const used = [control, ...this.near.filter((other) => other !== control)];
    used.forEach(({ field }, i) => field.classList.toggle("near", i < NEAR));
    this.near = used.slice(0, NEAR);
  }

  add(field) {
    const slider = field.querySelector("input[type=range]");
    const box = field.querySelector("input[type=number]");
    const other = field.querySelector("select, input[type=checkbox]");
    const { start } = field.dataset;
    const control = { field, slider, box, other, start, value: Number(start), log: slider?.dataset.log !== undefined };
    this.fields.set(field.dataset.name, control);
    for (const kind of ["input", "change"]) field.addEventListener(kind, () => this.use(control));
    slider?.addEventListener("input", () => {
      const raw = Number(slider.value);
      const value = control.log ? 10 ** raw : raw;
      const whole = slider.step !== "any";
      // digits that a slider can tell apart
      const digits = Math.max(0, Math.ceil(Math.log10(1000 / (slider.max - slider.min))));
      this.write(control, whole ? value : Number(control.log ? value.toPrecision(3) : value.toFixed(digits)));
      this.say(control);
      this.changed(field.dataset.name);
    });
    box?.addEventListener("input", () => {
      if (!this.isNumber(box)) return;
      control.value = Number(box.value);
      this.slide(control);
      this.changed(field.dataset.name);
    });
    other?.addEventListener("change", () => this.changed(field.dataset.name));
    if (box) this.write(control, control.value);
    if (slider) this.slide(control);
  }

  /** Take a number, and show as much of it as there is room for. */
  write(control, value) {
    control.value = value;
    control.box.value = String(Number(value.toPrecision(6)));
    this.isNumber(control.box);
  }

  isNumber(box) {
    const good = box.value.trim() !== "" && Number.isFinite(Number(box.value));
    box.setAttribute("aria-invalid", String(!good));
    return good;
  }

  /** Put the slider where the number is. */
  slide(control) {
    const { slider, value, log } = control;
    if (!slider) return;
    slider.value = String(log ? Math.log10(value) : value);
    this.say(control);
  }

  say({ slider, box, field }) {
    slider.setAttribute("aria-valuetext", `${box.value} ${field.dataset.unit ?? ""}`.trim());
  }

  /** Value of a control; while something else than a number is typed, the last one. */
  get(name) {
    const { value, other } = this.fields.get(name);
    if (!other) return value;
    return other.type === "checkbox" ? other.checked : Number(other.value);
  }

  /** Values by name. */
  values() {
    return Object.fromEntries([...this.fields.keys()].map((name) => [name, this.get(name)]));
  }

  set(name, value) {
    const control = this.fields.get(name);
    if (control.other?.type === "checkbox") control.other.checked = Boolean(Number(value));
    else if (control.other) control.other.value = String(value);
    else {
      this.write(control, Number(value));
      this.slide(control);
    }
  }

  reset() {
    for (const [name, { start }] of this.fields) this.set(name, start);
  }
}
