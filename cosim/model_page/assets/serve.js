// The worker's side of a page: it computes what the page asks for last.
//
// `serve(compute)` answers each request by `compute(request, models)`, a generator that yields the share that is done
// from time to time, so that the worker hears of newer requests, and returns the result.

const LONG = 1000; // ms after which a request gives way to a newer one before it is done

/** @param {(request: any, models: Record<string, Model>) => Generator<number, any, void>} compute */
function serve(compute) {
  /** @type {Record<string, Model>} */
  const models = {};
  let wanted = null;
  let computing = false;
  const { port1: pause, port2: go } = new MessageChannel(); // a pause without the 4 ms of a timer

  const heard = () =>
    new Promise((resolve) => {
      pause.onmessage = resolve;
      go.postMessage(null);
    });

  async function work() {
    computing = true;
    while (wanted) {
      const request = wanted;
      wanted = null;
      const began = performance.now();
      try {
        const computation = compute(request, models);
        let step = computation.next();
        let last = began;
        while (!step.done) {
          const now = performance.now();
          if (now - last > 8) {
            if (now - began > 200) postMessage({ id: request.id, share: step.value });
            await heard();
            last = performance.now();
            if (wanted && last - began > LONG) break;
          }
          step = computation.next();
        }
        if (step.done) {
          const buffers = transferable(step.value);
          postMessage({ id: request.id, result: step.value, took: performance.now() - began }, buffers);
        }
      } catch (error) {
        postMessage({ id: request.id, trouble: error instanceof Error ? error.message : String(error) });
      }
    }
    computing = false;
  }

  onmessage = async ({ data }) => {
    if (data.modules) {
      try {
        for (const [name, { code, description }] of Object.entries(data.modules)) {
          models[name] = await load(code, description);
        }
        postMessage({ ready: true });
      } catch (error) {
        postMessage({ ready: false, trouble: error instanceof Error ? error.message : String(error) });
      }
      return;
    }
    wanted = data;
    if (!computing) work();
  };
}

/** Buffers of the arrays in a result, which go to the page without a copy. */
function transferable(value) {
  if (ArrayBuffer.isView(value)) return [value.buffer];
  if (value === null || typeof value !== "object") return [];
  return Object.values(value).flatMap(transferable);
}
