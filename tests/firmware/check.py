#!/usr/bin/env python3
"""The host against a firmware that somebody else wrote from firmware-protocol.md alone (reference_rig.py): a conformance run
with motion over a pseudo-terminal, then a run through the daemon. Usage: check.py PATH_OF_LEAFBENCH
"""
import json
import os
import pathlib
import pty
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
BENCH = HERE.parent.parent / "bench-configs/benches/mock-serial.toml"
CALIBRATION = "0x627D8DF3"  # of that bench file, worked out in firmware-protocol.md


def start_rig():
    rig = subprocess.Popen([sys.executable, HERE / "reference_rig.py", "--calibration-hash", CALIBRATION],
                           stdout=subprocess.PIPE, text=True)
    return rig, rig.stdout.readline().strip()


def at_a_terminal(command, answer):
    """Runs a command that asks a person at the terminal, and answers."""
    process, terminal = pty.fork()
    if process == 0:
        os.execv(command[0], command)
    seen = b""
    answered = False
    while True:
        try:
            piece = os.read(terminal, 65536)
        except OSError:  # the far end is closed
            break
        if not piece:
            break
        seen += piece
        if not answered and b"type MOVE" in seen:
            os.write(terminal, answer)
            answered = True
    _, status = os.waitpid(process, 0)
    return os.waitstatus_to_exitcode(status), seen.decode(errors="replace")


def check_rig(leafbench):
    rig, port = start_rig()
    code, text = at_a_terminal([leafbench, "rig-check", "--link", f"serial:{port}", "--motion"], b"MOVE\n")
    rig.terminate()
    print(text)
    assert code == 0, f"rig-check ended with {code}"


def run_a_profile(leafbench, folder):
    rig, port = start_rig()
    # A shared machine holds a process in user space up for longer than a rig is ever silent.
    text = BENCH.read_text()
    keys = {"address": f'"serial:{port}"', "lease_ms": "500", "silence_ms": "300"}
    lines = [f"{line.split('=')[0]}= {keys.pop(line.split()[0])}" if line.split() and line.split()[0] in keys else line
             for line in text.splitlines()]
    bench = folder / "benches/bench.toml"
    bench.parent.mkdir()
    (folder / "specimens").symlink_to(BENCH.parent.parent / "specimens")
    bench.write_text("\n".join(lines).replace("[link]", "[link]\n" + "".join(f"{k} = {v}\n" for k, v in keys.items())))
    data = folder / "runs"
    daemon = subprocess.Popen([leafbench, "daemon", "--bench", bench, "--data", data, "--listen", "127.0.0.1:0",
                               "--profiles", BENCH.parent.parent / "profiles"])
    try:
        deadline = time.monotonic() + 60
        while True:
            status = subprocess.run([leafbench, "status", "--data", data, "--json"], capture_output=True, text=True)
            if status.returncode == 0 and json.loads(status.stdout)["rig"]["phase"] == "ready":
                break
            assert time.monotonic() < deadline, f"the bench is not ready: {status.stdout}{status.stderr}"
            time.sleep(0.2)
        time.sleep(1)
        run = subprocess.run([leafbench, "run", "static-ramp-12s", "--data", data, "--json"], capture_output=True, text=True)
        assert run.returncode == 0, f"{run.stdout}{run.stderr}"
        told = json.loads(run.stdout)
        print({key: told.get(key) for key in ("run_id", "ending", "samples", "lost", "late")})
        assert told["ending"] == "completed" and told["lost"] == 0, told
    finally:
        daemon.terminate()
        daemon.wait()
        rig.terminate()


def main():
    leafbench = os.path.abspath(sys.argv[1])
    check_rig(leafbench)
    with tempfile.TemporaryDirectory() as folder:
        run_a_profile(leafbench, pathlib.Path(folder))
    print("the independent firmware passes")


if __name__ == "__main__":
    main()
