// @ts-check
/**
 * A model as a WebAssembly module, for pages, workers and other hosts of JavaScript.
 *
 *     const model = await load(await (await fetch("Tank.wasm")).arrayBuffer());
 *     const { time, values } = model.simulate({ start: { area: 0.2 }, record: ["level"] });
 *
 * It imports nothing and asks for nothing: what it needs stands in the module.
 */

/**
 * @typedef {number | boolean | string} Value  A string is one of a string's texts, or the name of an enumeration's item.
 * @typedef {{ name: string, causality: "parameter" | "input" | "output" | "local", variability: string,
 *   type: "real" | "integer" | "boolean" | "enumeration" | "string", unit: string, description?: string, start?: number,
 *   min?: number, max?: number, items?: [string, number][] }} Variable
 *   A scalar; in `start` a Boolean is 0 or 1, an enumeration or a string the number of its item.
 * @typedef {{ name: string, reference: number, shape: number[], description: string }} Declared
 *   A variable as the model declares it: an array stands for as many scalars, from the one at `reference` on.
 * @typedef {{ name: string, description: string, tool: string, solver: string | null,
 *   experiment: { startTime: number, stopTime: number, stepSize: number }, variables: Variable[], declared: Declared[],
 *   tables: { name: string, size: [number, number], data: number[] }[] }} Description
 * @typedef {{ start?: Record<string, Value>, startTime?: number, stopTime?: number, stepSize?: number,
 *   inputs?: Record<string, ((time: number) => Value) | Float64Array>, linear?: boolean, record?: string[],
 *   tolerance?: number }} Settings
 *   Of a simulation: start values of parameters and inputs, times (s), inputs as functions of the time (s) or as values
 *   at the communication points, which are held or with `linear` go on linearly between them, and the variables to
 *   record, by default all outputs.
 * @typedef {{ time: Float64Array, values: Record<string, Float64Array>, error: string | null, warnings: string[] }} Run
 *   Times (s) and values at the communication points; with an error, those before it.
 */

/** What a model says when it refuses a value or can't go on. */
export class ModelError extends Error {
  name = "ModelError";
}

/** What is said where a browser has no WebAssembly, or a page's policy forbids it. */
export class NoWebAssembly extends Error {
  name = "NoWebAssembly";
}

const ERROR = 2; // statuses from here on
const SECTION = "model";
const CHUNK = 1024; // communication points between two pauses

/**
 * Compile a module.
 * @param {BufferSource} bytes
 * @param {Description} [description]  By default the one that stands in the module.
 * @returns {Promise<Model>}
 */
export async function load(bytes, description) {
  if (typeof WebAssembly === "undefined") {
    throw new NoWebAssembly("This browser has no WebAssembly, or it is switched off; the model can't run here.");
  }
  let module;
  try {
    module = await WebAssembly.compile(bytes);
  } catch (error) {
    const why = error instanceof Error ? error.message : String(error);
    throw new NoWebAssembly(`This browser refuses the model's WebAssembly: ${why}`);
  }
  return new Model(module, description ?? described(module));
}

/** @param {WebAssembly.Module} module @returns {Description} */
function described(module) {
  const [section] = WebAssembly.Module.customSections(module, SECTION);
  if (!section) throw new ModelError("The module does not describe itself; give its description, too.");
  return JSON.parse(new TextDecoder().decode(section));
}

/** A compiled model; its instances are independent of each other. */
export class Model {
  /** @param {WebAssembly.Module} module @param {Description} description */
  constructor(module, description) {
    this.module = module;
    this.description = description;
    /** @type {Map<string, number>} Value reference of each variable. */
    this.references = new Map(description.variables.map((variable, i) => [variable.name, i]));
    /** @type {Instance | null} Whose memory serves all simulations. */
    this.kept = null;
  }

  /** @param {"parameter" | "input" | "output" | "local"} causality @returns {string[]} Names of the scalars. */
  names(causality) {
    return this.description.variables.filter((v) => v.causality === causality).map((v) => v.name);
  }

  /** @param {string} name @returns {number} */
  reference(name) {
    const found = this.references.get(name);
    if (found === undefined) throw new ModelError(`${this.description.name} has no variable '${name}'`);
    return found;
  }

  /**
   * The number that stands for a value.
   * @param {string} name @param {Value} value @returns {number}
   */
  number(name, value) {
    if (typeof value !== "string") return Number(value);
    const { items } = this.description.variables[this.reference(name)];
    const item = items?.find(([text]) => text === value);
    if (item) return item[1];
    throw new ModelError(`'${name}' can't be '${value}'` + (items ? `, but ${items.map(([t]) => t).join(", ")}` : ""));
  }

  /** @param {Record<string, Value>} [start]  Other start values than the model's. */
  instantiate(start = {}) {
    return new Instance(this, start);
  }

  /** Simulate in one go. @param {Settings} [settings] @returns {Run} */
  simulate(settings = {}) {
    const simulation = this.simulation(settings);
    for (;;) {
      const { done, value } = simulation.next();
      if (done) return value;
    }
  }

  /**
   * Simulate in pieces: each `next` goes on for some communication points and yields the share that is done.
   * @param {Settings} [settings] @returns {Generator<number, Run, void>}
   */
  *simulation(settings = {}) {
    const { experiment } = this.description;
    const startTime = settings.startTime ?? experiment.startTime;
    const stopTime = settings.stopTime ?? experiment.stopTime;
    const stepSize = settings.stepSize ?? experiment.stepSize;
    const n = Math.round((stopTime - startTime) / stepSize);
    const isWhole = Math.abs(startTime + n * stepSize - stopTime) <= 1e-6 * stepSize;
    if (!(stepSize > 0 && n >= 1 && Number.isSafeInteger(n) && isWhole)) {
      throw new ModelError(`From ${startTime} s to ${stopTime} s is not a whole number of steps of ${stepSize} s`);
    }
    const names = settings.record ?? this.names("output");
    const time = Float64Array.from({ length: n + 1 }, (_, i) => startTime + i * stepSize);
    this.kept ??= this.instantiate();
    return yield* this.kept.recorded(settings, names, time, stepSize);
  }
}

/** An instance of a model: a module with a memory of its own. */
export class Instance {
  /** @param {Model} model @param {Record<string, Value>} [start] */
  constructor(model, start = {}) {
    this.model = model;
    /** @type {string[]} */
    this.warnings = [];
    /** @type {Map<string, { address: number, bytes: number }>} */
    this.blocks = new Map();
    /** @type {any} */
    this.module = new WebAssembly.Instance(model.module, {}).exports;
    model.description.tables.forEach(({ size, data }, i) => {
      const address = this.module.tableData(i, ...size);
      new Float64Array(this.module.memory.buffer, address, data.length).set(data);
    });
    this.writeStartValues(start);
    this.check(this.module.instantiate());
  }

  /** Go back to the start values, and others where they are given. @param {Record<string, Value>} [start] */
  reset(start = {}) {
    this.writeStartValues(start);
    this.check(this.module.reset());
  }

  /** @param {number} [time] @param {number} [tolerance]  Relative, for methods that choose their steps. */
  initialize(time = this.model.description.experiment.startTime, tolerance = 0) {
    this.check(this.module.initialize(time, tolerance));
  }

  /** Go on from a time by a communication step (s). @param {number} time @param {number} size */
  step(time, size) {
    this.check(this.module.step(time, size));
  }

  /** @param {Record<string, Value>} values */
  set(values) {
    const names = Object.keys(values);
    const references = this.referencesOf("names", names);
    const numbers = this.floats("values", names.length);
    names.forEach((name, i) => (numbers[i] = this.model.number(name, values[name])));
    this.check(this.module.set(references, names.length, numbers.byteOffset));
  }

  /** Values of variables, as numbers. @param {string[]} names @returns {number[]} */
  get(names) {
    const references = this.referencesOf("names", names);
    const { byteOffset } = this.floats("values", names.length);
    this.check(this.module.get(references, names.length, byteOffset));
    return [...this.floats("values", names.length)];
  }

  /**
   * @param {Settings} settings @param {string[]} names @param {Float64Array} time @param {number} stepSize
   * @returns {Generator<number, Run, void>}
   */
  *recorded(settings, names, time, stepSize) {
    const points = time.length;
    this.warnings = [];
    /** @type {string | null} */
    let error = null;
    let complete = 0;
    try {
      this.reset(settings.start);
      this.initialize(time[0], settings.tolerance);
      const references = this.referencesOf("recorded", names);
      const driven = Object.entries(settings.inputs ?? {});
      const inputs = this.model.names("input");
      for (const [name] of driven) {
        if (!inputs.includes(name)) throw new ModelError(`${this.model.description.name} has no input '${name}'`);
      }
      const resting = driven.length ? this.get(inputs) : [];
      for (let first = 0; first < points - 1; first += CHUNK) {
        const steps = Math.min(CHUNK, points - 1 - first);
        // all memory before any address is taken: it may move when it grows
        this.floats("columns", names.length * points);
        this.floats("row", names.length);
        const rows = driven.length ? this.floats("inputs", inputs.length * (steps + 1)) : null;
        for (let i = 0; rows && i <= steps; i++) rows.set(resting, i * inputs.length);
        for (const [name, of] of driven) {
          const place = inputs.indexOf(name);
          for (let i = 0; rows && i <= steps; i++) {
            const value = typeof of === "function" ? of(time[first + i]) : of[first + i];
            rows[i * inputs.length + place] = this.model.number(name, value);
          }
        }
        const done = this.module.run(
          time[0], stepSize, first, steps, rows?.byteOffset ?? 0, settings.linear ? 1 : 0, references, names.length,
          this.floats("row", names.length).byteOffset, this.floats("columns", names.length * points).byteOffset, points,
        ); // prettier-ignore
        complete = first + done;
        if (done <= steps) {
          error = this.message();
          break;
        }
        yield complete / points;
      }
    } catch (reason) {
      if (!(reason instanceof ModelError)) throw reason;
      error = reason.message;
    }
    const columns = this.floats("columns", names.length * points);
    /** @type {Record<string, Float64Array>} */
    const values = {};
    names.forEach((name, k) => (values[name] = columns.slice(k * points, k * points + complete)));
    return { time: time.slice(0, complete), values, error, warnings: this.warnings };
  }

  /** What the model said last. @returns {string} */
  message() {
    const bytes = new Uint8Array(this.module.memory.buffer, this.module.message());
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
  }

  /** @param {number} status */
  check(status) {
    if (status >= ERROR) throw new ModelError(this.message());
    if (status > 0) this.warnings.push(this.message());
  }

  /** @param {Record<string, Value>} start */
  writeStartValues(start) {
    const known = this.model.description.variables.filter((v) => v.causality === "parameter" || v.causality === "input");
    const numbers = new Float64Array(this.module.memory.buffer, this.module.startValues(), known.length);
    known.forEach((variable, i) => (numbers[i] = variable.start ?? 0));
    for (const [name, value] of Object.entries(start)) {
      const place = this.model.reference(name); // parameters and inputs come first
      if (place >= known.length) throw new ModelError(`'${name}' is computed and has no start value to set`);
      numbers[place] = this.model.number(name, value);
    }
  }

  /** Room for n numbers in the module's memory, the same each time. @param {string} what @param {number} n */
  floats(what, n) {
    const address = this.room(what, 8 * n); // before the memory is looked at, which may move when it grows
    return new Float64Array(this.module.memory.buffer, address, n);
  }

  /** @param {string} what @param {string[]} names @returns {number} Address of their value references. */
  referencesOf(what, names) {
    const address = this.room(`references of ${what}`, 4 * names.length);
    const references = names.map((name) => this.model.reference(name));
    new Uint32Array(this.module.memory.buffer, address, names.length).set(references);
    return address;
  }

  /** @param {string} what @param {number} bytes @returns {number} */
  room(what, bytes) {
    let block = this.blocks.get(what);
    if (!block || block.bytes < bytes) {
      block = { address: this.module.allocate(Math.max(bytes, 8)), bytes };
      if (!block.address) throw new ModelError(`No memory for ${Math.round(bytes / 1e6)} MB of results`);
      this.blocks.set(what, block);
    }
    return block.address;
  }
}
