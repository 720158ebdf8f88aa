#!/usr/bin/env python3
"""Ray gives the table that one process gives: with two workers, with a worker killed, with the driver killed and started again.
Usage: ray_check.py PATH_OF_LEAFBENCH [RUNS]. The packages leafbench and ray must be installed.
"""
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time

import psutil


def diagnose(archive, *options):
    return [sys.executable, "-m", "leafbench.fleet", "diagnose", str(archive), *options]


def table(archive):
    return {str(path.relative_to(archive)): path.read_bytes() for path in archive.glob("diagnoses/**/*.parquet")}


def workers_of(driver):
    """Processes of Ray that diagnose. One that ends meanwhile is none."""
    found = []
    for process in psutil.Process(driver.pid).children(recursive=True):
        try:
            if "ray::diagnosed" in " ".join([process.name(), *process.cmdline()]):
                found.append(process)
        except psutil.Error:
            pass
    return found


def main():
    leafbench = str(pathlib.Path(sys.argv[1]).resolve())
    runs = sys.argv[2] if len(sys.argv) > 2 else "120"
    with tempfile.TemporaryDirectory() as name:
        work = pathlib.Path(name)
        subprocess.run([leafbench, "lab", "--out", work / "lab", "--specimens", "12", "--runs", runs, "--seed", "11"], check=True)
        archive = work / "archive"
        subprocess.run([leafbench, "archive", archive, work / "lab/runs"], check=True)
        copies = {what: pathlib.Path(shutil.copytree(archive, work / what)) for what in ("alone", "ray", "worker", "driver")}
        began = time.monotonic()
        subprocess.run(diagnose(copies["alone"], "--workers", "1", "--estimates-only"), check=True)
        alone_s = time.monotonic() - began
        began = time.monotonic()
        ray = ("--engine", "ray", "--workers", "2", "--estimates-only")
        subprocess.run(diagnose(copies["ray"], *ray), check=True)
        ray_s = time.monotonic() - began
        wanted = table(copies["alone"])
        assert len(wanted) == int(runs), len(wanted)
        assert table(copies["ray"]) == wanted, "Ray wrote another table"
        print(f"one process {alone_s:.1f} s, Ray with two workers {ray_s:.1f} s (its start is in it): {alone_s / ray_s:.2f} times as fast")

        driver = subprocess.Popen(diagnose(copies["worker"], *ray))
        killed = 0
        while driver.poll() is None:
            time.sleep(0.2)
            found = workers_of(driver)
            if found and killed < 3:
                random.choice(found).send_signal(signal.SIGKILL)
                killed += 1
                time.sleep(1)
        assert driver.returncode == 0 and killed > 0, (driver.returncode, killed)
        assert table(copies["worker"]) == wanted, "another table after a worker was killed"
        print(f"{killed} workers killed: the same table")

        # Killed once after its first commit and before its last one, then let to its end.
        driver = subprocess.Popen(diagnose(copies["driver"], *ray), start_new_session=True)
        while driver.poll() is None and not table(copies["driver"]):
            time.sleep(0.05)
        driver.kill()
        driver.wait()
        there = len(table(copies["driver"]))
        assert 0 < there < int(runs), f"{there} of {runs} runs were diagnosed at the kill: give more runs"
        # What Ray had started for it.
        subprocess.run([pathlib.Path(sys.executable).with_name("ray"), "stop", "--force"], capture_output=True)
        subprocess.run(diagnose(copies["driver"], *ray), check=True)
        assert table(copies["driver"]) == wanted, "another table after the driver was killed"
        subprocess.run([leafbench, "verify", copies["driver"], "--runs", work / "lab/runs"], check=True)
        print(f"driver killed when {there} of {runs} runs were there, and started again: the same table, nothing twice")


if __name__ == "__main__":
    main()
