"""python convert.py source=THEIRS target=FOLDER [to=FORMAT] [key=value …]: others' data and weights, in and out."""

import hydra
from omegaconf import DictConfig

from gns_pl.errors import told_plainly


@hydra.main(version_base=None, config_path="conf", config_name="convert")
def main(cfg: DictConfig) -> None:
    """Convert with one config."""
    with told_plainly("convert.py"):
        from gns_pl.conversion.door import convert_config

        try:
            convert_config(cfg)
        except KeyboardInterrupt:
            raise SystemExit("convert.py: stopped; the same command goes on where it was.") from None


if __name__ == "__main__":
    main()
