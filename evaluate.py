"""python evaluate.py ckpt=FILE [key=value …]: judge a checkpoint on test scenes against MPM computed on demand."""

import sys

import hydra
from omegaconf import DictConfig

from gns_pl.errors import told_plainly


@hydra.main(version_base=None, config_path="conf", config_name="evaluate")
def main(cfg: DictConfig) -> None:
    """Evaluate with one config."""
    with told_plainly("evaluate.py"):
        from gns_pl.evaluation.evaluate import evaluate_config

        evaluate_config(cfg)


if __name__ == "__main__":
    # +evaluation=stress, as +experiment=… is typed, is what Hydra calls evaluation=stress.
    sys.argv = [arg[1:] if arg.startswith("+evaluation=") else arg for arg in sys.argv]
    main()
