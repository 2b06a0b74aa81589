"""The workcell: what there is, what an arm has to do there, and in which order."""
