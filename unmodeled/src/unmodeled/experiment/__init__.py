"""Experiments: what a proposed record would tell about parameters and causes.

The information of a planned record follows from the derivatives of the model, as in a diagnosis.
"""

from unmodeled.experiment.information import Belief
from unmodeled.experiment.planning import Plan, PlannedRecord, SinglePartTest, Visible, plan

__all__ = ["Belief", "Plan", "PlannedRecord", "SinglePartTest", "Visible", "plan"]
