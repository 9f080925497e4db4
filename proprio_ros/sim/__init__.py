"""Physics in NVIDIA Warp: one file per law.

``joint``  one driven joint, everything else locked and merged (the paper's equation (1) for one degree of freedom);
``chain``  any number of active joints, serial or tree;
``payload`` how what the hand holds enters either of them.
"""
