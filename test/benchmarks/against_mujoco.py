"""The same identification by ``mujoco.sysid``, MuJoCo's own system identification (finite differences, box-bounded LM).

Set up in MuJoCo's favour: held joints welded, constraints off, no resampling, and RK4 with our step, the cheapest setting with
our accuracy (its default, Euler at 2 ms, is a gram off). Same samples, weights, priors and starts as ours.
"""

from __future__ import annotations

from case import Case, Row, compare

from proprio_ros.addons.paper.speed import SysidSearch

GOAL = 300.0


def rows(case: Case) -> list[Row]:
    """The comparison, or why there is none."""
    what = "mujoco.sysid, five starts"
    try:
        import mujoco
        from absl import logging
        from mujoco import sysid
    except ImportError:
        return [Row(what, note="skipped: needs pip install 'mujoco[sysid]>=4'")]
    if not hasattr(sysid, "optimize"):
        return [Row(what, note="skipped: needs the extra, pip install 'mujoco[sysid]>=4'")]
    logging.set_verbosity(logging.ERROR)  # it warns of a light start near its bound
    return [
        compare(
            f"{what} (MuJoCo {mujoco.__version__}, RK4)",
            SysidSearch(case, case.step_s),
            GOAL,
            case,
        )
    ]
