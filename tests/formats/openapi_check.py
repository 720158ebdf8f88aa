"""Starts a daemon and validates its OpenAPI description: openapi_check.py PROGRAM. Needs openapi-spec-validator."""

import json
import subprocess
import sys
import tempfile
import urllib.request

from openapi_spec_validator import validate

with tempfile.TemporaryDirectory() as data:
    command = [sys.argv[1], "daemon", "--json", "--bench", "bench-configs/benches/mock.toml", "--listen", "127.0.0.1:0", "--data", data]
    daemon = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        url = json.loads(daemon.stdout.readline())["url"]
        with open(f"{data}/token") as file:
            token = file.read().strip()
        request = urllib.request.Request(f"{url}/api/openapi.json", headers={"Authorization": f"Bearer {token}"})
        with urllib.request.urlopen(request, timeout=60) as answer:
            description = json.load(answer)
    finally:
        daemon.terminate()
        daemon.wait(timeout=60)

try:
    validate(description)
except Exception as error:  # The whole description is in its text.
    sys.exit(f"not valid: {type(error).__name__}: {str(error)[:500]}")
answers = [
    (path, method, status, answer.get("description", ""))
    for path, item in description["paths"].items()
    for method, operation in item.items()
    for status, answer in operation["responses"].items()
]
mute = [answer for answer in answers if not answer[3]]
assert not mute, f"answers without a description: {mute}"
print(f"valid: {len(description['paths'])} addresses, {len(answers)} answers with a description")
