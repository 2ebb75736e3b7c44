"""The robustness study that the paper lacks: uncertain factors, their effects, and the trade-off of the gains."""
