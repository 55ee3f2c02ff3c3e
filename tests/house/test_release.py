"""What a release and the workflows need: one version everywhere, licences of what is shipped, targets that exist."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import pytest
import yaml
from parsed import PACKAGE, ROOT, name_of, text_of

import alight

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = tomllib.loads(text_of(ROOT / "pyproject.toml"))["project"]
TARGETS = set(re.findall(r"^([a-z-]+):", text_of(ROOT / "Makefile"), re.M))


def jobs_of(workflow: dict[str, Any]) -> list[dict[str, Any]]:
    """Jobs of a workflow."""
    return list(workflow["jobs"].values())


def test_the_citation_names_this_version_and_licence() -> None:
    cited = yaml.safe_load(text_of(ROOT / "CITATION.cff"))
    assert cited["version"] == alight.__version__
    assert cited["license"] == PROJECT["license"]


def test_every_licence_of_the_source_is_in_the_wheel() -> None:
    assert {"LICENSE", *map(name_of, PACKAGE.rglob("LICENSE*"))} == set(PROJECT["license-files"])


@pytest.mark.parametrize("path", WORKFLOWS, ids=name_of)
def test_a_workflow_runs_what_make_runs_with_few_rights(path: object) -> None:
    workflow = yaml.safe_load(text_of(path))  # type: ignore[arg-type]
    runs = [step["run"] for job in jobs_of(workflow) for step in job["steps"] if "run" in step]
    called = {word for run in runs for word in re.findall(r"^make ([a-z-]+)$", run)}
    assert called
    assert called <= TARGETS
    assert workflow["permissions"] == {"contents": "read"}


def test_the_tests_run_on_every_python_that_the_package_names() -> None:
    workflow = yaml.safe_load(text_of(ROOT / ".github" / "workflows" / "ci.yml"))
    named = {c.rsplit(" ", 1)[1] for c in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", c)}
    assert set(workflow["jobs"]["test"]["strategy"]["matrix"]["python"]) == named
