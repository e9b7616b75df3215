"""What holds for all tests, wherever they are run from."""

from __future__ import annotations

import os
import signal

os.environ.pop("COLUMNS", None)  # tests of tables say how wide the screen is

# A shell starts what runs in the background deaf to Ctrl-C, and so would be all that tests start and stop.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
