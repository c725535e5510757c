"""Write commands and examples of the manual page share/kreisel.1 as the program has them: `python design/man_page.py`.

The other sections are written by hand.
"""

from __future__ import annotations

import re
from pathlib import Path

from kreisel.cli.command_help import COMMANDS, START

PAGE = Path(__file__).resolve().parents[1] / "share" / "kreisel.1"


def roff(text: str) -> str:
    """Return a text as troff wants it."""
    return re.sub(r"(?m)^([.'])", r"\\&\1", text.replace("\\", "\\e").replace("-", "\\-"))


def page(now: str) -> str:
    """Return the page with its two sections made anew; the others stay as they are."""
    commands = "".join(f".TP\n.B {roff(name)}\n{roff(said.summary)}\n" for name, said in COMMANDS.items())
    lines = [*START, *(line for said in COMMANDS.values() for line in said.examples)]
    examples = ".nf\n" + "".join(f"{roff(line)}\n" for line in dict.fromkeys(lines)) + ".fi\n"
    for name, content in (("COMMANDS", commands), ("EXAMPLES", examples)):
        parts = re.split(rf"(?<=\n)(\.SH {name}\n).*?(?=\.SH |\Z)", now, flags=re.S)
        if len(parts) != 3:
            raise SystemExit(f"{PAGE}: expected one section {name}")
        now = parts[0] + parts[1] + content + parts[2]
    return now


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
