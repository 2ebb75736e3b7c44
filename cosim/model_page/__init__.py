"""Pages that run a model in the browser, as WebAssembly: controls, plots of outputs, and all that a page needs."""
