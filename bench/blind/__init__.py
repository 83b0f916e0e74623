"""Machines of known truth, and the yardstick of the diagnosis.

Its parts are as independent as possible: the *models* with their libraries of effects
(:mod:`~blind.key_hammer`, the packaged action), the *generators* of truths, which share no code
with them (:mod:`~blind.truth`, :mod:`~blind.action_truth`, :mod:`~blind.imperfect`), the *sets* of
cases (:mod:`~blind.yardstick_sets`), and the *marks*, which read stored answers only
(:mod:`~blind.marks`).
"""
