"""How the executables in scripts/ start: import late, so that failing to is one line too."""

from __future__ import annotations

import importlib
import os
import sys

from bullet_lab.errors import LabError

STATUS_CANNOT_START = 1
STATUS_INTERRUPTED = 130


def run(target: str) -> None:
    """Import "module" or "module:function" and call its `main` or function.

    Where a library is missing, that ends with one line.
    """
    module, _, function = target.partition(":")
    name = os.path.basename(sys.argv[0])
    # With several, the last bit of a sum depends on how many cores there are.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        main = getattr(importlib.import_module(module), function or "main")
    except KeyboardInterrupt:
        sys.exit(STATUS_INTERRUPTED)
    except LabError as error:
        _end(f"{name}: {error}")
    except ImportError as error:
        hint = "run scripts/setup.sh, or install what package.xml and requirements.txt name"
        _end(f"{name}: {error} (for {sys.executable}): {hint}")
    main()


def _end(line: str) -> None:
    print(line, file=sys.stderr)
    sys.exit(STATUS_CANNOT_START)
