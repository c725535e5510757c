"""Every decoder given bytes that are changed until they reach new branches, for as long as one likes.

``python -m tests.protocols.fuzz -max_total_time=600``; needs atheris. The arguments are those of libFuzzer.
"""

import sys

import atheris

with atheris.instrument_imports(include=["kreisel.protocols", "kreisel.geometry.kuka"]):
    from tests.protocols.test_streams import attack_all


def main() -> None:
    atheris.Setup(sys.argv, attack_all)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
