"""Plug-ins that misbehave, of all kinds: what is done, and in which method."""

from __future__ import annotations

from textwrap import dedent, indent
from typing import NamedTuple

HEAD = """
import atexit, builtins, ctypes, faulthandler, gc, io, os, pickle, random, resource, signal, subprocess, sys
import threading, time, warnings
import numpy as np
from rangefix.filters import Estimate

class Odd(Exception):
    def __str__(self): raise RuntimeError("no words")
    def __reduce__(self): raise RuntimeError("not to be pickled")

class Good:
    def __init__(self, problem): self.problem = problem
    def init(self, prior, rng): return prior.mean + rng.standard_normal(2), np.array(prior.covariance)
    def predict(self, belief, control, rng): return belief
    def update(self, belief, measurement, rng):
        mean, covariance = belief
        return mean + 0.01 * rng.standard_normal(2), covariance
    def estimate(self, belief): return Estimate(belief[0].copy(), belief[1].copy(), 0.0)
"""
SIGNATURES = {
    "__init__": "self, problem",
    "init": "self, prior, rng",
    "predict": "self, belief, control, rng",
    "update": "self, belief, measurement, rng",
    "estimate": "self, belief",
}


class Fault(NamedTuple):
    """A fault of a plug-in.

    Attributes:
        where: "import", or the method in which it is committed.
        code: Statements; what the method of a good plug-in does comes after them, unless they return.
        accident: Whether it happens by accident: in our own process, too, it costs nobody else anything.
    """

    where: str
    code: str
    accident: bool = False

    def text(self) -> str:
        """A file with the estimators `Good`, and `Bad` with the fault."""
        code = dedent(self.code).strip()
        if self.where == "import":
            return f"{HEAD}\nclass Bad(Good): pass\n{code}\n"
        signature = SIGNATURES[self.where]
        usual = f"return super().{self.where}({signature.removeprefix('self, ')})"
        method = f"def {self.where}({signature}):\n{indent(code, '    ')}\n    {usual}\n"
        return f"{HEAD}\nclass Bad(Good):\n{indent(method, '    ')}"


HANG = "while True: pass"
SLEEP = "time.sleep(1000)"
FAULTS = {
    # what everybody shares, by accident
    "moves the prior's mean": Fault("init", "mean = prior.mean; mean += 1.0", True),
    "shrinks the prior's covariance": Fault("init", "prior.covariance[:] = 0.0", True),
    "turns the beams": Fault("__init__", "problem.sensor.bearings[0] = 1.0", True),
    "writes into the measurement": Fault("update", "measurement[np.isfinite(measurement)] = 1.0", True),
    "sorts the measurement": Fault("update", "measurement.sort()", True),
    "writes into its belief": Fault("update", "belief[0][:] += 1.0", True),
    "returns what it keeps": Fault("estimate", "return Estimate(belief[0], belief[1], 0.0)", True),
    "changes what it returned": Fault(
        "estimate",
        "self.kept = getattr(self, 'kept', np.zeros(2)); self.kept += 1.0\n"
        "return Estimate(self.kept, np.eye(2), 0.0)",
        True,
    ),
    "seeds numpy when imported": Fault("import", "np.random.seed(0)", True),
    "seeds numpy in every update": Fault("update", "np.random.seed(0)", True),
    "draws from numpy": Fault("update", "np.random.normal(size=1000)", True),
    "seeds and draws from Python": Fault("update", "random.seed(1); random.random()", True),
    "draws much from its stream": Fault("update", "rng.standard_normal(100_000)", True),
    "winds back its stream": Fault("update", "rng.bit_generator.state = np.random.PCG64(1).state", True),
    "numpy raises when imported": Fault("import", "np.seterr(all='raise')", True),
    "numpy raises": Fault("update", "np.seterr(all='raise')", True),
    "numpy ignores": Fault("__init__", "np.seterr(all='ignore')", True),
    "numpy calls": Fault("update", "np.seterrcall(print); np.seterr(all='call')", True),
    "warnings are errors": Fault("import", "warnings.simplefilter('error')", True),
    "warns a thousand times": Fault("update", "[warnings.warn(f'careful {n}') for n in range(1000)]", True),
    "prints floats otherwise": Fault("import", "np.set_printoptions(precision=1, legacy='1.13')", True),
    "one thread for numba": Fault("update", "import numba; numba.set_num_threads(1)", True),
    "one thread for BLAS": Fault("update", "import threadpoolctl; threadpoolctl.threadpool_limits(1)", True),
    "no garbage is collected": Fault("import", "gc.disable()", True),
    "goes elsewhere": Fault("update", "os.chdir('/')", True),
    "sets variables": Fault("import", "os.environ['OMP_NUM_THREADS'] = '1'; os.environ['HOME'] = '/'", True),
    "raises": Fault("update", "raise RuntimeError('no')", True),
    "divides by zero": Fault("update", "1 / 0", True),
    "recursion without an end": Fault("update", "self.update(belief, measurement, rng)", True),
    "an estimate of three components": Fault(
        "estimate", "return Estimate(np.zeros(3), np.eye(3), 0.0)", True
    ),
    "an estimate of float32": Fault(
        "estimate",
        "return Estimate(belief[0].astype('f4'), belief[1].astype('f4'), 0.0)",
        True,
    ),
    "complex": Fault("estimate", "return Estimate(belief[0] * 1j, belief[1], 0.0)", True),
    "objects": Fault("estimate", "return Estimate(belief[0].astype(object), belief[1], 0.0)", True),
    "masked": Fault(
        "estimate",
        "return Estimate(np.ma.masked_array(belief[0], [True, False]), belief[1], 0.0)",
        True,
    ),
    "not a number": Fault("estimate", "return Estimate(np.full(2, np.nan), belief[1], 0.0)", True),
    "infinite covariance": Fault(
        "estimate", "return Estimate(belief[0], np.full((2, 2), np.inf), 0.0)", True
    ),
    "largest numbers": Fault("estimate", "return Estimate(np.full(2, 1e308), 1e308 * np.eye(2), 0.0)", True),
    "a covariance that is none": Fault("estimate", "return Estimate(belief[0], -belief[1], 0.0)", True),
    "a lopsided covariance": Fault(
        "estimate", "return Estimate(belief[0], np.array([[1, 9], [0, 1.0]]))", True
    ),
    "a rank of one": Fault("estimate", "return Estimate(belief[0], np.ones((2, 2)), 0.0)", True),
    "evidence in words": Fault("estimate", "return Estimate(*belief, 'high')", True),
    "no estimate": Fault("estimate", "return None", True),
    "no belief": Fault("update", "return None", True),
    "a belief that cannot be pickled": Fault("update", "return *belief, threading.Lock()", True),
    # what ends, stops or fills a process
    "exits when imported": Fault("import", "sys.exit(3)"),
    "ends when imported": Fault("import", "os._exit(3)"),
    "hangs when imported": Fault("import", SLEEP),
    "is no Python": Fault("import", "def ("),
    "exits": Fault("update", "sys.exit('enough')"),
    "ends": Fault("update", "os._exit(0)"),
    "aborts": Fault("update", "os.abort()"),
    "reads address 0": Fault("update", "ctypes.string_at(0)"),
    "kills itself": Fault("predict", "os.kill(os.getpid(), signal.SIGKILL)"),
    "interrupts itself": Fault("update", "raise KeyboardInterrupt"),
    "stops itself": Fault("update", "os.kill(os.getpid(), signal.SIGSTOP)"),
    "hangs": Fault("predict", HANG),
    "sleeps": Fault("estimate", SLEEP),
    "hangs and cannot be told to end": Fault("update", "faulthandler.cancel_dump_traceback_later()\n" + HANG),
    "hangs in a group of its own": Fault("update", "os.setpgid(0, os.getsid(0))\n" + HANG),
    "an alarm": Fault("update", "signal.alarm(1); " + SLEEP),
    "a timer": Fault("import", "signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)"),
    "ignores signals": Fault(
        "import", "[signal.signal(each, signal.SIG_IGN) for each in (signal.SIGTERM, signal.SIGCHLD)]"
    ),
    "forks": Fault("update", "os.fork()"),
    "forks and the copy hangs": Fault("update", "os.fork() or time.sleep(20)"),
    "starts programs": Fault("update", "subprocess.Popen(['sleep', '20'])"),
    "threads that go on": Fault("update", f"threading.Thread(target=lambda: {SLEEP}).start()"),
    "a thread that dies": Fault("update", "threading.Thread(target=lambda: 1 / 0).start()"),
    "a thread that ends the process": Fault("init", "threading.Timer(0.05, os._exit, (7,)).start()"),
    "hangs in the end": Fault("import", f"atexit.register(lambda: {SLEEP})"),
    "takes a terabyte": Fault("update", "np.ones(2**37)"),
    "takes more and more": Fault(
        "update", "held = []\nwhile True:\n    held.append(np.ones(5_000_000)); time.sleep(0.02)"
    ),
    "a huge belief": Fault("update", "return belief[0], belief[1], np.ones(5_000_000)"),
    "little memory for itself": Fault("init", "resource.setrlimit(resource.RLIMIT_AS, (1 << 20, 1 << 20))"),
    # what is told and shown
    "a huge message": Fault("update", "raise RuntimeError('x' * 5_000_000)"),
    "a message with escapes": Fault("update", "raise RuntimeError('\\x1b[2J\\x1b]0;title\\x07\\n\\n=1+1')"),
    "an exception without words": Fault("update", "raise Odd"),
    "a deep cause": Fault(
        "update",
        "error = None\nfor _ in range(2000):\n    one = ValueError('x'); one.__cause__, error = error, one\n"
        "raise error",
    ),
    "prints much": Fault("update", "print('x' * 3_000_000); sys.stderr.write('y' * 3_000_000)"),
    "writes to the pipes": Fault("update", "[os.write(n, b'\\0' * 100) for n in (1, 2)]"),
    "writes answers": Fault(
        "update",
        "content = pickle.dumps((1, True, None))\nos.write(1, len(content).to_bytes(8, 'little') + content)",
    ),
    "closes its output": Fault("update", "sys.stdout.close(); sys.stderr.close()"),
    "closes all files": Fault("update", "os.closerange(0, 100)"),
    "closes all files when imported": Fault("import", "os.closerange(0, 100)"),
    # what it makes of the interpreter
    "another inverse": Fault("import", "np.linalg.inv = np.linalg.solve = np.linalg.cholesky = None"),
    "another pickle": Fault("update", "pickle.dumps = pickle.loads = None"),
    "another clock": Fault("import", "time.monotonic = time.perf_counter = lambda: 0.0"),
    "no open": Fault("import", "builtins.open = None"),
    "no modules": Fault("update", "sys.modules.clear()"),
    "no paths": Fault("import", "sys.path.clear()"),
    "no room to call": Fault("import", "sys.setrecursionlimit(60)"),
    "another problem": Fault("__init__", "object.__setattr__(problem, 'sensor', None)"),
    "opens arrays": Fault("update", "measurement.setflags(write=True); measurement[:] = 0.0"),
    "another estimate": Fault("import", "Estimate.__init__ = lambda *all: None"),
    "traces": Fault("import", "sys.settrace(lambda *all: 1 / 0)"),
    "no variables": Fault("import", "os.environ.clear()"),
}
