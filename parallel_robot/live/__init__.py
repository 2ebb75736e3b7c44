"""The robot in the browser: its closed loop as WebAssembly, with controls for gains, path and what acts on it."""
