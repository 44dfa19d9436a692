"""The simulated rig: one scene, three devices, virtual time.

It renders sound and pictures and hands no estimate to anybody: its own edges, echoes, lens and ray casting, so that a
mistake in calibration cannot hide behind the same mistake here. What is true is in `Rig.truth`, for evaluation only.
"""
