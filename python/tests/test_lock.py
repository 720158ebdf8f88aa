"""Other threads go on, Ctrl-C ends the work, a panic is an exception."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest
from conftest import loops

import leafbench
from leafbench import _leafbench


def test_a_python_thread_goes_on_while_two_threads_diagnose(measured, helper_leaf_bench):
    """A thread that only counts gets at least a third of the turns that it gets alone; with the lock held it would get none."""
    results, stop, turns = [], threading.Event(), [0]

    def diagnose():
        results.append(leafbench.diagnose(measured[0], bench=helper_leaf_bench, threads=1).json)

    def wake():
        while not stop.is_set():
            turns[0] += 1
            time.sleep(0.001)

    waking = threading.Thread(target=wake)
    waking.start()
    began = time.monotonic()
    time.sleep(0.3)
    alone = turns[0] / (time.monotonic() - began)
    workers = [threading.Thread(target=diagnose) for _ in range(2)]
    before, began = turns[0], time.monotonic()
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    took = time.monotonic() - began
    beside = (turns[0] - before) / took
    stop.set()
    waking.join()
    print(f"{alone:.0f} turns/s alone, {beside:.0f} beside two diagnoses of {took:.1f} s")
    assert took > 0.1 and beside > alone / 3
    assert len(results) == 2 and results[0] == results[1]


def test_an_exception_in_the_progress_ends_the_work_and_is_raised(measured):
    class Enough(Exception):
        pass

    def progress(share, step):
        raise Enough(step)

    with pytest.raises(Enough):
        leafbench.diagnose(measured, progress=progress)
    with pytest.raises(Enough):
        leafbench.identify(loops(), model="equivalent", method="differential-evolution", progress=progress)
    with pytest.raises(TypeError):
        leafbench.diagnose(measured, progress=lambda share: None)


@pytest.mark.skipif(os.name != "posix", reason="needs SIGINT")
@pytest.mark.parametrize(
    "call",
    [
        "leafbench.diagnose([leafbench.simulate(p, rig=True) for p in ('sine-6mm-2.5hz-10', 'static-ramp-12s')], "
        "bench='samurai-rail', progress=begun, threads=1)",
        "leafbench.identify(leafbench.simulate('static-ramp'), model='finite-segment', method='differential-evolution', progress=begun)",
        "begun() or leafbench.simulate(LONG)",
        "begun() or leafbench.plan(LONG)",
        "begun() or leafbench.simulate(LONG, rig=True)",
    ],
    ids=["diagnose", "identify", "simulate", "plan", "simulate on the rig"],
)
def test_ctrl_c_ends_a_long_computation(call):
    program = textwrap.dedent(
        f"""
        import leafbench
        LONG = 'name = "long"\\ncontrol = "displacement"\\n[[block]]\\nrepeat = 1000\\nsegment = [' \\
            '{{ kind = "ramp", to_mm = 5.0, duration_s = 20.0 }}, {{ kind = "ramp", to_mm = 0.0, duration_s = 20.0 }}]\\n'
        def begun(*_):
            print("begun", flush=True)
        try:
            {call}
            print("done")
        except KeyboardInterrupt:
            print("interrupted")
        """
    )
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "begun\n", process.stderr.read()
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    out, err = process.communicate(timeout=60)
    ended_s = time.monotonic() - began
    print(f"{ended_s:.2f} s from Ctrl-C to the end of the process")
    assert out.splitlines()[-1] == "interrupted", (out[-200:], err)
    # The longest step of a fit, on a busy machine.
    assert process.returncode == 0 and ended_s < 20


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_computes_too():
    """As multiprocessing does it on Linux. A pool of threads that was shared with the parent would hang here."""
    program = textwrap.dedent(
        """
        import os, signal, leafbench
        recording = leafbench.simulate("sine-6mm-2.5hz-10")
        leafbench.diagnose(recording)
        child = os.fork()
        if child == 0:
            signal.alarm(60)
            leafbench.diagnose(recording)
            leafbench.identify(recording, model="equivalent")
            os._exit(7)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
        """
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "7", (done.stdout, done.stderr)


def test_a_panic_is_an_exception_that_asks_for_a_report(capfd):
    if not hasattr(_leafbench, "provoke_panic"):
        pytest.skip("a wheel for users has no call that panics")
    with pytest.raises(leafbench.InternalError, match="please report") as raised:
        _leafbench.provoke_panic()
    assert "asked for by a test" in str(raised.value)
    assert leafbench.models()
    capfd.readouterr()
