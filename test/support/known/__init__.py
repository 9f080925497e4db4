"""Recordings whose truth is known, and what is answered to them: `bases`, `simulated`, `asking`."""
