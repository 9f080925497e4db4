"""Physics in NVIDIA Warp: one file per law.

``rollout`` the time walk that all laws share;
``joint``  one driven joint, everything else locked and merged (the paper's equation (1) for one degree of freedom);
``payload`` how what the hand holds enters it;
``sphere`` a sphere that rolls in a container;
``mesh``, ``energies``, ``quasistatic`` a soft block of tetrahedra in equilibrium between two fingers (numpy and scipy);
``response`` its force, tabulated; ``squeeze`` a gripper that closes on it.
"""
