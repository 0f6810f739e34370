"""`gns-pl COMMAND …`: the commands of an installed package, those of the files at the root of the repository."""

from __future__ import annotations

import importlib
import sys

from gns_pl.text import did_you_mean, use_program

COMMANDS = ("train", "evaluate", "simulate", "generate", "benchmark", "convert", "fit")


def main() -> None:
    """Run the command that was named.

    Raises:
        SystemExit: status 2 if there is none of that name.
    """
    typed = sys.argv[1:]
    if not typed or typed[0] in ("-h", "--help"):
        print(f"gns-pl COMMAND [key=value …], where COMMAND is one of {', '.join(COMMANDS)}; gns-pl COMMAND --help")
        raise SystemExit(0 if typed else 2)
    name = typed[0]
    if name not in COMMANDS:
        known = ", ".join(COMMANDS)
        print(f"gns-pl: there is no command {name}{did_you_mean(name, COMMANDS)}; there are {known}.", file=sys.stderr)
        raise SystemExit(2)
    use_program("gns-pl {}")
    sys.argv = [f"gns-pl {name}", *typed[1:]]
    importlib.import_module(f"gns_pl.commands.{name}").run()


if __name__ == "__main__":
    main()
