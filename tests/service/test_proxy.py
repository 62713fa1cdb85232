"""deploy/nginx.conf before a page: TLS, users, and users who may only look."""

from __future__ import annotations

import http.client
import json
import os
import ssl
import subprocess
import time
from base64 import b64encode
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import which

import pytest

from studies.service.processes import free_port
from tests.patience import PATIENCE
from tests.service.fake_engine import FakePlant
from tests.service.loopback import Served, served, until

NGINX = which("nginx") or which("nginx", path="/usr/sbin")
FILE = Path(__file__).parents[2] / "deploy" / "nginx.conf"
pytestmark = pytest.mark.skipif(NGINX is None or which("openssl") is None, reason="nginx or openssl is not installed")

ADDRESS, USERS = "127.0.0.1", {"users": ("looker", "writer"), "writers": ("writer",)}


@contextmanager
def proxy(place: Path, page: Served) -> Iterator[int]:
    """Run nginx with the file of the repository before the page, and yield the port of nginx."""
    port, own = free_port(), page.page._server.servers[0].sockets[0].getsockname()[1]
    text = FILE.read_text(encoding="utf-8").replace("/etc/pmfid/", f"{place}/").replace("TOKEN", page.token)
    text = text.replace("127.0.0.1:8127", f"127.0.0.1:{own}").replace("listen 443", f"listen {ADDRESS}:{port}")
    key = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=hall.example"
    names = ["-addext", "subjectAltName=DNS:hall.example", "-keyout", "hall.example.key", "-out", "hall.example.pem"]
    subprocess.run([*key.split(), *names], cwd=place, check=True, capture_output=True)
    for file, users in USERS.items():
        secret = subprocess.run(["openssl", "passwd", "-apr1", "secret"], check=True, capture_output=True, text=True)
        (place / file).write_text("".join(f"{user}:{secret.stdout}" for user in users))
        (place / file).chmod(0o644)
    user = "user root; " if os.geteuid() == 0 else ""  # otherwise the workers may not read the folder
    head = f"{user}daemon off; pid {place}/pid; error_log {place}/error.log; events {{}}\n"
    kept = " ".join(f"{one}_temp_path {place}/{one};" for one in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi"))
    (place / "nginx.conf").write_text(f"{head}http {{ access_log off; {kept}\n{text}}}\n")
    place.chmod(0o755)
    with subprocess.Popen([str(NGINX), "-p", place, "-c", place / "nginx.conf"], stderr=subprocess.DEVNULL) as process:
        try:
            yield port
        finally:
            process.terminate()


class Client:
    """Requests of a user through the proxy, as a browser that has his password sends them."""

    def __init__(self, place: Path, port: int, user: str) -> None:
        context = ssl.create_default_context(cafile=str(place / "hall.example.pem"))
        context.check_hostname = False  # the name hall.example is not that of this machine
        self.line = http.client.HTTPSConnection(ADDRESS, port, timeout=PATIENCE, context=context)
        self.headers = {"Host": "hall.example", "Origin": "https://hall.example", "Content-Type": "application/json"}
        self.headers |= {"Authorization": f"Basic {b64encode(f'{user}:secret'.encode()).decode()}"} if user else {}

    def ask(self, path: str, method: str = "GET") -> http.client.HTTPResponse:
        self.line.close()
        self.line.request(method, path, b"{}" if method == "POST" else None, self.headers)
        return self.line.getresponse()


def test_the_proxy_has_the_users_and_the_page_one_token(tmp_path: Path) -> None:
    plant = FakePlant(2)
    plant.run(2.0)
    number = plant.alarm("gantry-x1")
    with served(plant, hosts=("hall.example",)) as page, proxy(tmp_path, page) as port:
        assert until(lambda: (tmp_path / "pid").exists())
        time.sleep(0.2)
        nobody, looker, writer = (Client(tmp_path, port, user) for user in ("", "looker", "writer"))
        acknowledge = f"/api/alarms/{number}/acknowledge"
        assert [one.ask("/api/plant").status for one in (nobody, looker, writer)] == [401, 200, 200]
        assert [one.ask(acknowledge, "POST").status for one in (nobody, looker, writer)] == [401, 401, 202]
        assert json.loads(looker.ask("/api/news").read())["first"]
        for client in (nobody, looker, writer):
            client.line.close()
