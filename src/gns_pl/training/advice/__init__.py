"""The adviser behind `python train.py … advise=true`: what a data set and the settings of a training mean together.

`derived` computes it from the survey of the data (`data.survey`), `data_errors` and `suggestions` judge it, `report`
shows it, `advise` is what the command calls. Nothing is trained here.
"""

from gns_pl.training.advice.advise import advise

__all__ = ["advise"]
