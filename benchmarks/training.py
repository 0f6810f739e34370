"""Windows per second of a training step, and where its time goes, beside a plain reference loop in the same run.

    python benchmarks/training.py                                             # the quickstart's settings
    python benchmarks/training.py +experiment=cube106 steps=5 data.root=…     # any overrides of conf/train.yaml

The reference is the same network with the same weights, data, batches, noise and optimiser, written plainly: edge
inputs concatenated from both ends and the edge, `index_add` for the sums, a k-d tree per graph in the training process
for the neighbours, windows loaded in that process. Both run in blocks that take turns; the medians of the blocks are
compared. "whole" is a step of `python train.py`, Lightning, weight averaging and logging included.
"""

from __future__ import annotations

import copy
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hydra
import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig, OmegaConf
from torch import Tensor, nn
from torch.nn.functional import smooth_l1_loss
