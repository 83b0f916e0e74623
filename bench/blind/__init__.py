"""Blind bench of the gap diagnosis: sealed cases, their diagnosis, the score.

It has four parts that are as independent as possible: the *model* with its library of effects
(:mod:`~blind.key_hammer`), the *generator* of truths, which shares no code with it
(:mod:`~blind.truth`), the *bench* that seals, diagnoses and stores (:mod:`~blind.bench`), and the
*scorer*, which reads stored files only (:mod:`~blind.score`).
"""
