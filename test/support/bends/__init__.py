"""Ways in which recordings go wrong, one module a kind; `bend.BENDS` has them all once `all_bends` was called.

A bend takes a `Tape` (a bag in memory, column by column), a random generator and its parameters, and returns another tape. A module
of a kind adds one with

    @bend("clocks", Right(cause="clock|stamp"), factor=between(0.5, 2.0),)
    def loop_slower_than_stamps(tape: Tape, rng: Rng, factor: float) -> Tape:

`messages.py` bends single messages, `files.py` the bytes of a bag.
"""
