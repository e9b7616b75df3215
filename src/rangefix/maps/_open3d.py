"""Open3D, imported when first needed and with libusb found for it: no apt-get on a bare machine."""

from __future__ import annotations

import ctypes
import importlib
import re
import sys
import warnings
from functools import cache
from typing import Any

LIBUSB = "libusb-1.0.so.0"
PACKAGES = {  # Debian and Ubuntu names of the system libraries that open3d links to
    "libusb-1.0": "libusb-1.0-0",
    "libgomp": "libgomp1",
    "libGL": "libgl1",
    "libEGL": "libegl1",
    "libX11": "libx11-6",
    "libudev": "libudev1",
    "libidn2": "libidn2-0",
}


@cache
def open3d() -> Any:
    """The package open3d.

    Raises:
        ImportError: If open3d or a system library that it links to is missing; one line with what to install.
    """
    if sys.platform.startswith("linux"):
        _load_libusb()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the packages that open3d imports, not of ours
            return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise ImportError(
            f"casting into floor plans and meshes needs {error.name}: pip install open3d"
        ) from error
    except (ImportError, OSError) as error:
        raise ImportError(_explain(str(error))) from error


def _load_libusb() -> None:
    """The system's libusb where there is one, else that of the wheel libusb-package."""
    try:
        ctypes.CDLL(LIBUSB, mode=ctypes.RTLD_GLOBAL)
        return
    except OSError:
        pass
    try:
        path = importlib.import_module("libusb_package").get_library_path()
        if path is not None:
            ctypes.CDLL(str(path), mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # open3d says which library it misses


def _explain(reason: str) -> str:
    found = re.search(r"(lib[\w.+-]+?)\.so[\w.]*", reason)
    if "cannot open shared object" not in reason or found is None:
        return f"open3d does not load: {reason}"
    package = PACKAGES.get(found.group(1))
    install = f"apt-get install {package}" if package else "install the system package that holds it"
    if found.group(0) == LIBUSB:
        install = f"pip install libusb-package (or {install})"
    return f"open3d needs the system library {found.group(0)}, which is missing: {install}"
