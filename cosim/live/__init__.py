"""The live view of a run: its page on the loopback while it goes on, in a process of its own."""
