"""What the paper itself says, as far as it is available here; nothing else is put beside our rows.

Chen et al., "Learning Object Properties Using Robot Proprioception via Differentiable Robot-Object Interaction", ICRA 2025,
arXiv:2410.03920. Its tables could not be read here cell by cell: what follows are the ranges and numbers that this project's design
and the authors' public example (github.com/MediosZ/WarpDiffRobot) rest on.
"""

from __future__ import annotations

MISSING = "not available here"
TITLE = "Learning Object Properties Using Robot Proprioception via Differentiable Robot-Object Interaction"
AUTHORS = "Peter Yichen Chen, Chao Liu, Pingchuan Ma, John Eastman, Daniela Rus, Dylan Randle, Yuri Ivanov, Wojciech Matusik"
ADDRESS = "https://arxiv.org/abs/2410.03920"

# of table I over its four objects; which has which is not available here
MASS_ERRORS = "2 to 6 g, 10 to 28 %"
TIME = "2.5 to 2.7 s (Apple M1 Max)"  # to identify the mass
STARTS_END = "55 to 58 g"  # table II, heavy ball of 50 g
SPHERE_ERROR = "6 g (50 %)"  # V-B, a sphere of 12 g
LAME = {"light cube": (749.6, 264.3), "heavy cube": (5097.6, 5430.4)}
"""V-C: mu and lambda [Pa] that it found; nothing says what is true of the cubes."""
