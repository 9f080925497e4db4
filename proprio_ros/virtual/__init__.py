"""A robot without hardware: Protocol 2.0 servos on a pseudo-terminal, a MuJoCo arm behind them."""
