// The page's side: a worker from the page's own text, asked for the newest wish whenever it has nothing to do.

class Engine {
  /**
   * `worker`: its text. `modules`: name -> { block, description }, where a block of the page has the deflated module.
   * `hear`: functions `ready()`, `result(result, { took, waited })`, `share(part)`, `trouble(text)`.
   */
  constructor(worker, modules, hear) {
    this.hear = hear;
    this.id = 0;
    this.waiting = null; // what is being computed
    this.next = null; // what is to be computed then
    this.isReady = false;
    this.start(worker, modules).catch((error) => hear.trouble(String(error.message ?? error)));
  }

  async start(worker, modules) {
    if (typeof WebAssembly === "undefined") {
      throw new Error("This browser has no WebAssembly, or it is switched off; the model can't run here.");
    }
    const address = URL.createObjectURL(new Blob([worker], { type: "text/javascript" }));
    this.worker = new Worker(address);
    this.worker.onerror = (event) => {
      event.preventDefault();
      this.hear.trouble(event.message || "This browser does not start the worker that runs the model.");
    };
    this.worker.onmessage = ({ data }) => this.heard(data);
    const codes = {};
    for (const [name, { block, description }] of Object.entries(modules)) {
      codes[name] = { code: (await inflated(block)).buffer, description };
    }
    this.worker.postMessage({ modules: codes }, Object.values(codes).map(({ code }) => code));
  }

  /** Ask for a computation; of several wishes while one is computed only the last is kept. */
  ask(request) {
    this.next = { ...request, id: ++this.id, asked: performance.now() };
    if (this.isReady && (!this.waiting || performance.now() - this.waiting.sent > 1000)) this.send();
  }

  send() {
    this.waiting = { ...this.next, sent: performance.now() };
    this.next = null;
    const { asked, sent, ...request } = this.waiting;
    this.worker.postMessage(request);
  }

  heard(data) {
    if (data.ready !== undefined) {
      this.isReady = data.ready;
      if (!data.ready) this.hear.trouble(data.trouble);
      else {
        this.hear.ready?.();
        if (this.next) this.send();
      }
      return;
    }
    if (data.id !== this.waiting?.id) return; // of a request that gave way
    if (data.share !== undefined) {
      this.hear.share?.(data.share);
      return;
    }
    const { asked } = this.waiting;
    this.waiting = null;
    if (data.trouble !== undefined) this.hear.trouble(data.trouble);
    else this.hear.result(data.result, { took: data.took, waited: performance.now() - asked });
    if (this.next) this.send();
  }
}
