"""Threads, progress and Ctrl-C."""

import signal
import subprocess
import sys
import threading
import time
import unittest
from pathlib import Path

import taut
from common import CANTILEVER, MODULE, InFolder
from test_run import without_circumstances


class Threads(InFolder):
    def test_of_python_count_on_while_taut_computes(self):
        experiment = taut.Experiment(MODULE)
        counted, done = 0, threading.Event()

        def count():
            nonlocal counted
            while not done.wait(0.001):
                counted += 1

        counting = threading.Thread(target=count)
        counting.start()
        began, before = time.monotonic(), counted
        experiment.replay(threads=1)
        seconds, during = time.monotonic() - began, counted - before
        done.set()
        counting.join()
        # With the lock held throughout it were one or two.
        self.assertGreater(seconds, 0.1)
        self.assertGreater(during, 20 * seconds)

    def test_may_compute_at_the_same_time(self):
        expected = taut.Experiment(CANTILEVER).replay()["predicted"]
        found = [None] * 4

        def replay(place):
            found[place] = taut.Experiment(CANTILEVER).replay()["predicted"]

        threads = [threading.Thread(target=replay, args=(k,)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for values in found:
            self.assertEqual(list(values), list(expected))

    def test_of_blas_are_given_back(self):
        import ctypes

        library = ctypes.CDLL("libopenblas.so.0")
        library.openblas_set_num_threads(3)
        taut.Experiment(CANTILEVER).replay()
        self.assertEqual(library.openblas_get_num_threads(), 3)


class Progress(InFolder):
    def test_is_told_line_by_line_in_the_thread_that_waits(self):
        lines, threads = [], set()

        def progress(line):
            lines.append(line)
            threads.add(threading.get_ident())

        taut.Experiment(CANTILEVER).fit(variants=False, progress=progress)
        self.assertEqual(threads, {threading.get_ident()})
        self.assertTrue(any(line.startswith("fitting 12 readings") for line in lines), lines)

    def test_that_raises_ends_the_work(self):
        def progress(line):
            raise KeyError("enough")

        with self.assertRaises(KeyError) as caught:
            taut.Experiment(MODULE).fit(out="run", progress=progress)
        self.assertIsNone(caught.exception.result)
        self.assertFalse(Path("run/fit.json").exists())


class CtrlC(InFolder):
    PROGRAM = """
import sys, taut
def progress(line):
    print(line, flush=True)
try:
    taut.Experiment({path!r}).fit(out="run", variants={variants}, progress=progress)
except KeyboardInterrupt as stopped:
    run = stopped.result
    print("STOPPED", *([run] if run is None else [run.status, run.folder]), flush=True)
    sys.exit(130)
print("FINISHED", flush=True)
"""

    def interrupted(self, path, words, variants):
        return self.run_interrupted(self.PROGRAM.format(path=str(path), variants=variants), words)

    def run_interrupted(self, text, words):
        """What a program prints that is interrupted once it has said `words`; its exit code."""
        program = subprocess.Popen([sys.executable, "-c", text],
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                                   preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler))
        said = ""
        for line in program.stdout:
            said += line
            if words in line:
                program.send_signal(signal.SIGINT)
                break
        rest, errors = program.communicate(timeout=120)
        self.assertEqual(errors, "")
        return said + rest, program.returncode

    def test_ends_a_fit_that_goes_on_later_to_the_same_result(self):
        said, code = self.interrupted(CANTILEVER, "fit, search: evaluation ", True)
        self.assertEqual(code, 130, said)
        self.assertIn("STOPPED", said)
        self.assertNotIn("FINISHED", said)
        self.assertTrue(Path("run/.resume").exists())
        lines = []
        run = taut.Experiment(CANTILEVER).fit(out="run", progress=lines.append)
        self.assertTrue(any(line.startswith("going on with an interrupted run") for line in lines), lines)
        self.assertFalse(Path("run/.resume").exists())
        whole = taut.Experiment(CANTILEVER).fit()
        self.assertEqual(without_circumstances(run.record)["parameters"], without_circumstances(whole.record)["parameters"])
        self.assertEqual(list(run.readings["predicted"]), list(whole.readings["predicted"]))

    def test_after_the_search_keeps_what_is_finished(self):
        said, code = self.interrupted(CANTILEVER, "other equilibria", True)  # a variant
        self.assertEqual(code, 130, said)
        self.assertIn("STOPPED converged run", said)
        run = taut.Run("run")
        self.assertEqual((run.status, run.record["interrupted"]), ("converged", True))
        self.assertLess(len(run.record["variants"]), 2)  # the second one takes seconds
        self.assertTrue(Path("run/.unfinished").exists())

    def test_leaves_a_finished_run_where_it_is(self):
        whole = taut.Experiment(CANTILEVER).fit(out="run")
        said, code = self.interrupted(CANTILEVER, "other equilibria", True)
        self.assertEqual(code, 130, said)
        self.assertIn("STOPPED converged None", said)  # what was found is not in the folder
        self.assertEqual(taut.Run("run").record, whole.record)

    def test_ends_a_simulation_and_keeps_its_states(self):
        program = """
import sys, taut
try:
    taut.simulate({path!r}, out="run", progress=lambda line: print(line, flush=True))
except KeyboardInterrupt as stopped:
    print("STOPPED", len(stopped.result.time), stopped.result.time[-1])
    sys.exit(130)
"""
        path = MODULE.parents[1] / "ball_impact/experiment.toml"
        said, code = self.run_interrupted(program.format(path=str(path)), " steps")
        self.assertEqual(code, 130, said)
        _, samples, last = said.splitlines()[-1].split()
        self.assertGreater(int(samples), 1)
        rows = Path("run/channels.csv").read_text(encoding="utf-8").splitlines()
        self.assertEqual(len(rows) - 1, int(samples))
        self.assertAlmostEqual(float(rows[-1].split(",")[0]), float(last), delta=1e-9)


if __name__ == "__main__":
    unittest.main()
