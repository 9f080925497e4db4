"""From runs to an estimate: unknowns with priors, the observation model, solvers, intervals, verdict."""
