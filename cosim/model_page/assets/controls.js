// Controls of values: a slider with a number beside it, a number alone, a switch, a choice.

class Controls {
  /** All controls inside an element, by the name in their `data-name`; `changed` is called after each change. */
  constructor(root, changed) {
    this.fields = new Map();
    this.changed = changed;
    for (const field of root.querySelectorAll("[data-name]")) this.add(field);
  }

  add(field) {
    const slider = field.querySelector("input[type=range]");
    const box = field.querySelector("input[type=number]");
    const other = field.querySelector("select, input[type=checkbox]");
    const control = { field, slider, box, other, start: field.dataset.start, log: slider?.dataset.log !== undefined };
    this.fields.set(field.dataset.name, control);
    slider?.addEventListener("input", () => {
      const raw = Number(slider.value);
      const value = control.log ? 10 ** raw : raw;
      const whole = slider.step !== "any";
      // digits that a slider can tell apart
      const digits = Math.max(0, Math.ceil(Math.log10(1000 / (slider.max - slider.min))));
      box.value = String(whole ? value : Number(control.log ? value.toPrecision(3) : value.toFixed(digits)));
      this.say(control);
      this.changed(field.dataset.name);
    });
    box?.addEventListener("input", () => {
      if (!this.isNumber(box)) return;
      this.slide(control);
      this.changed(field.dataset.name);
    });
    other?.addEventListener("change", () => this.changed(field.dataset.name));
    if (slider) this.slide(control);
  }

  isNumber(box) {
    const good = box.value.trim() !== "" && Number.isFinite(Number(box.value));
    box.setAttribute("aria-invalid", String(!good));
    return good;
  }

  /** Put the slider where the number is. */
  slide(control) {
    const { slider, box, log } = control;
    if (!slider) return;
    const value = Number(box.value);
    slider.value = String(log ? Math.log10(value) : value);
    this.say(control);
  }

  say({ slider, box, field }) {
    slider.setAttribute("aria-valuetext", `${box.value} ${field.dataset.unit ?? ""}`.trim());
  }

  /** Value of a control; null where no number is typed. */
  get(name) {
    const { box, other } = this.fields.get(name);
    if (other) return other.type === "checkbox" ? other.checked : other.dataset.items !== undefined ? Number(other.value) : other.value;
    return box.value.trim() !== "" && Number.isFinite(Number(box.value)) ? Number(box.value) : null;
  }

  /** Values by name; of a number that is none, the start value. */
  values() {
    const found = {};
    for (const name of this.fields.keys()) found[name] = this.get(name) ?? Number(this.fields.get(name).start);
    return found;
  }

  set(name, value) {
    const control = this.fields.get(name);
    if (control.other?.type === "checkbox") control.other.checked = Boolean(Number(value));
    else if (control.other) control.other.value = String(value);
    else {
      control.box.value = String(value);
      this.isNumber(control.box);
      this.slide(control);
    }
  }

  reset() {
    for (const [name, { start }] of this.fields) this.set(name, start);
  }
}
