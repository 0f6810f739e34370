"""What every command does before and after its work: read what was typed, refuse what is no key, tell what went wrong.

Each command is a file of one shape; those at the root of the repository call them. Nothing of simulation, training or
evaluation belongs here.
"""

from gns_pl.commands.command import job, start, sweep_label

__all__ = ["job", "start", "sweep_label"]
