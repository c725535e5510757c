"""What things cost, as ratios within one run."""

import os

# as the command does: two processes with two threads each for small matrices stand in each other's way
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
