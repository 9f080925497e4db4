"""Physics in NVIDIA Warp: one file per law.

``joint``  one driven joint, everything else locked and merged (the paper's equation (1) for one degree of freedom);
``chain``  any number of active joints, serial or tree;
``payload`` how what the hand holds enters either of them;
``sphere`` a sphere that rolls in a container;
``mesh``, ``energies``, ``quasistatic`` a soft block of tetrahedra in equilibrium between two fingers (numpy and scipy);
``response`` its force, tabulated; ``squeeze`` a gripper that closes on it; ``softbody`` both moved explicitly, as in the paper.
"""
