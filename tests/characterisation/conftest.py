"""One BLAS thread, as recorded; too late, and then seen in the fingerprint, where numpy was imported before."""

import os
import sys

if "numpy" not in sys.modules:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
