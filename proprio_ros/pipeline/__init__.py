"""From what is asked to an answer: replay, calibrate, check, and the interface for scripts and notebooks."""
