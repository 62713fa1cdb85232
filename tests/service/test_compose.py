"""The files of deploy/compose name metrics, files and keys that exist."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from pmfid.service.metrics import HELP
from pmfid.service.plant import load_plant

REPOSITORY = Path(__file__).parents[2]
FOLDER = REPOSITORY / "deploy" / "compose"
#: Metrics of the process, which every service of Prometheus has.
PROCESS = {"process_resident_memory_bytes"}


def read_yaml(name: str) -> dict[str, dict[str, dict[str, list[str]]]]:
    yaml = pytest.importorskip("ruamel.yaml")
    return dict(yaml.YAML(typ="safe").load((FOLDER / name).read_text(encoding="utf-8")))


def test_the_dashboard_shows_metrics_that_the_service_has() -> None:
    dashboard = json.loads((FOLDER / "dashboard.json").read_text(encoding="utf-8"))
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    shown = set(re.findall(r"\b(?:pmfid|process)_\w+", " ".join(expressions)))
    assert len(shown) > 10
    assert shown <= HELP.keys() | PROCESS
    places = [tuple(panel["gridPos"].values()) for panel in dashboard["panels"]]
    assert len(set(places)) == len(places)


def test_the_services_mount_files_that_exist() -> None:
    services = read_yaml("compose.yaml")["services"]
    mounted = [one.split(":")[0] for service in services.values() for one in service["volumes"]]
    files = [name for name in mounted if name.startswith("./") and name != "./plant"]
    assert len(files) == 5
    assert [name for name in files if not (FOLDER / name).is_file()] == []
    assert (FOLDER / services["pmfid"]["build"]["context"] / services["pmfid"]["build"]["dockerfile"]).is_file()


def test_prometheus_asks_the_page_of_the_service(tmp_path: Path) -> None:
    """The head of the compose file has the keys of PLANT.toml with which Prometheus reaches the page."""
    (job,) = read_yaml("prometheus.yml")["scrape_configs"]
    head = (FOLDER / "compose.yaml").read_text(encoding="utf-8").partition("\nservices:")[0]
    keys = "\n".join(line.removeprefix("#   ") for line in head.splitlines() if re.match(r"#   (\[|\w+ = )", line))
    keys = keys.replace("[service]", '[service]\nname = "hall"').replace("/state", str(tmp_path))
    (tmp_path / "axis.toml").write_text((REPOSITORY / "examples/plant_axis.toml").read_text())
    source = '[axes.x1]\nconfig = "axis.toml"\n[sources.hall]\nkind = "mqtt"\nhost = "broker"\ntopics = ["a"]\n'
    (tmp_path / "PLANT.toml").write_text(f"{keys}\n{source}")
    page = load_plant(tmp_path / "PLANT.toml").page
    assert job["static_configs"][0]["targets"][0] in page.hosts
    assert page.token == "env:PMFID_TOKEN"


def test_images_are_pinned_and_every_port_is_of_this_machine() -> None:
    services = read_yaml("compose.yaml")["services"].values()
    images = [str(service["image"]) for service in services if "image" in service]
    bases = re.findall(r"^FROM (\S+)", (REPOSITORY / "deploy/Containerfile").read_text(encoding="utf-8"), re.MULTILINE)
    assert [image for image in [*images, *bases] if not re.search(r"@sha256:[0-9a-f]{64}$", image)] == []
    ports = [port for service in services for port in service.get("ports", ())]
    assert [port for port in ports if not port.startswith("127.0.0.1:")] == []


def test_actions_and_requirements_are_pinned() -> None:
    workflows = (REPOSITORY / ".github" / "workflows").glob("*.yml")
    used = [name for one in workflows for name in re.findall(r"uses: (\S+)", one.read_text(encoding="utf-8"))]
    assert [name for name in used if not re.search(r"@[0-9a-f]{40}$", name)] == []
    text = (REPOSITORY / "requirements-bench.txt").read_text(encoding="utf-8")
    assert len(re.findall(r"==", text)) == len(re.findall(r"== ?\S+.*\\\n    --hash=sha256:[0-9a-f]{64}", text)) > 0
