"""The functions of `import alight`, one per command; `live`, `fly`, `rehearse` and `settings` are commands only."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from alight.documents import parse_json, read_text
from alight.records import SettingsError
from alight.result import Result
from alight.settings import Lander, Settings, load_settings, settings_of_keys
from alight.settings.base import FrozenModel
from alight.settings.units import with_degrees

if TYPE_CHECKING:
    from alight.checks.result import CheckResult
    from alight.evaluation import Evaluation
    from alight.sources import Source
    from alight.training.confusion import Confusion
    from alight.trials.campaign.numbers import CampaignNumbers
    from alight_sim import SimulatedFlight
    from alight_sim.scene import Scene

Progress = Callable[[str, float], None]  # stage, share done
SettingsLike = Settings | Mapping[str, Any] | str | Path | None


def _quiet(stage: str, share: float) -> None:
    """Discard a report of progress."""


@contextmanager
def single_threaded_algebra() -> Iterator[None]:
    """Run linear algebra on one thread: the filter's matrices are too small to be shared between threads.

    With several threads, 30 of 52 s of CPU time were spent waiting, and sums in another order changed the last bits.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield


def settings_of(settings: SettingsLike = None, lander: Lander | None = None) -> Settings:
    """Return settings from a model, a mapping (`{"parallax.cell": 0.1}` or nested), or a YAML file.

    Args:
        settings: the settings, or the name of their YAML file; None: the defaults.
        lander: replaces the lander of `settings`; None: it is kept.

    Raises:
        SettingsError: a key is unknown, a value is out of range, or the file cannot be read.
    """
    try:
        if settings is None:
            chosen = Settings()
        elif isinstance(settings, Settings):
            chosen = settings
        elif isinstance(settings, Mapping):
            chosen = settings_of_keys({str(key): _plain_value(str(key), value) for key, value in settings.items()})
        else:
            chosen = load_settings(read_text(Path(settings)))
    except OSError as e:
        raise SettingsError(f"{settings}: cannot be read; name a YAML file of settings") from e
    except ValueError as e:
        raise SettingsError(str(e) if isinstance(settings, Mapping) else f"{settings}: {e}") from e
    return chosen if lander is None else chosen.model_copy(update={"lander": lander})


def _plain_value(key: str, value: Any) -> Any:
    """Return the value of the setting `key` (a model, path, NumPy scalar or array, or plain data) as JSON types."""
    import json

    def plain(value: Any) -> Any:
        if isinstance(value, FrozenModel):
            return with_degrees(value.model_dump(mode="json", exclude_unset=True), type(value))
        if isinstance(value, PurePath):
            return str(value)
        if hasattr(value, "tolist"):  # NumPy, which is not imported here
            return value.tolist()
        raise TypeError(f"a {type(value).__name__} is no value of a setting")

    try:
        return parse_json(json.dumps(value, default=plain))
    except (TypeError, ValueError, RecursionError) as e:
        raise SettingsError(f"{key}: {e}; give a number, a word, a list or a mapping of keys") from e


def run(
    source: str | Path | Source,
    *,
    lander: Lander | None = None,
    settings: SettingsLike = None,
    poses: str | None = None,
    prior_dem: str | Path | None = None,
    home: str | None = None,
    geoid: str | Path | None = None,
    zones: str | Path | None = None,
    scheduler: str | None = None,
    progress: Progress = _quiet,
) -> Result:
    """Find landing sites in a recorded flight or a folder of photos. No folder is written: see `Result.save`.

    Args:
        source: a folder (flight log or photos), an opened source, or a simulated flight.
        lander: footprint and limits of the aircraft; replaces the lander of `settings`.
        settings: a `Settings` model, a mapping of keys, or the name of a YAML file. If both this and `lander` are None,
            the defaults apply; the recording of a live run is run with the settings of its flight.
        poses: `truth`, or the name of a TUM file of body poses in ENU, to be used instead of the estimated motion.
        prior_dem: height raster from another source, used to begin the search for heights and for comparison.
        home: position where the vehicle that flies the route is armed, `LAT,LON,ALT_MSL`. It needs `geoid`, or the
            separation there (ellipsoid minus sea level, metres) as a fourth number. None: heights of `route.plan` are
            relative to the landing site.
        geoid: raster of geoid heights in metres, on a grid of degrees.
        zones: GeoJSON of zones where not to land, where only, where preferably (docs/zones.md).
        scheduler: address of a Dask cluster that processes the photos, such as tcp://host:8786.
        progress: called with the name of the stage and the share of it that is done.

    Raises:
        AlightError: the input or a setting cannot be used; the message gives the remedy.
    """
    from alight.cluster import open_jobs
    from alight.outputs import FileStore
    from alight.pipeline import PipelineOptions
    from alight.runner.opening import open_source
    from alight.runner.replay import prior_heights, replay, settings_for
    from alight.runs import known_home, with_home, zones_of

    chosen = settings_of(settings, lander)
    armed_at = known_home(home, None if geoid is None else Path(geoid))
    recording = open_source(Path(source), chosen) if isinstance(source, str | Path) else source
    chosen = settings_for(recording, chosen)
    prior = prior_heights(recording, chosen, None if prior_dem is None else Path(prior_dem))
    limits = zones_of(recording, chosen, None if zones is None else Path(zones))
    store = FileStore(Path(tempfile.gettempdir()))
    with single_threaded_algebra(), closing(store), open_jobs(scheduler) as jobs:
        options = PipelineOptions(prior=prior, tile_store=store, jobs=jobs, zones=limits)
        return Result(with_home(replay(recording, chosen, poses, progress, options), armed_at))


def judge(
    dem: str | Path,
    *,
    sigma: float | str | Path | None = None,
    image: str | Path | None = None,
    zones: str | Path | None = None,
    lander: Lander | None = None,
    settings: SettingsLike = None,
) -> Result:
    """Judge a height raster from another source: P(safe) and reasons of each cell, and the landing sites.

    Args:
        dem: a height raster with square cells, in metres or feet.
        sigma: 1-sigma of the heights, metres or a raster; None: the raster's second band, or `hazards.usual_sigma`.
        image: image of the same ground from above; with two or more pixels per cell it sharpens the heights.
        zones: as in `run`.
        lander: as in `run`.
        settings: as in `run`.

    Raises:
        AlightError: a raster or a setting cannot be used; the message gives the remedy.
    """
    from alight.runner import judge as runner
    from alight.sources.raster import read_ground

    chosen = runner.for_surveyed_heights(settings_of(settings, lander))
    ground = read_ground(
        Path(dem), None if sigma is None else str(sigma), None if image is None else Path(image),
        chosen.hazards.usual_sigma,
    )  # fmt: skip
    return runner.judge_ground(ground, chosen, Path(dem).name, None if zones is None else Path(zones))


def simulate(scene: str | Path | Scene = "demo", seed: int = 0, **wishes: Any) -> SimulatedFlight:
    """Simulate a flight and return it as a source for `run`; `alight_sim.write` writes it to a folder.

    Args:
        scene: the name of a built-in scene, a scene file (YAML), or a scene.
        seed: seed of the random ground and flight; another seed gives another site.
        wishes: `height` [m], `duration` [s], `speed` [m/s] and other arguments of `alight_sim.fly`.

    Raises:
        InputError: the scene does not exist, or the flight cannot be flown.
    """
    import alight_sim

    return alight_sim.fly(scene, seed, **wishes)


def evaluate(out: str | Path | Result, truth: str | Path) -> Evaluation:
    """Compare a run with the truth of a simulated flight or with a structure-from-motion reference.

    Raises:
        InputError: `out` is not a run, or the folder `truth` holds neither `truth/` nor `sfm_reference.npz`.
    """
    from alight.evaluation import evaluate as compare

    if not isinstance(out, Result):
        return compare(Path(out), Path(truth))
    with tempfile.TemporaryDirectory(prefix="alight-") as folder:
        out.save(folder)
        return compare(Path(folder), Path(truth))


def check(
    source: str | Path | Source, *, seconds: float = 10.0, start: float = 0.0, settings: SettingsLike = None
) -> list[CheckResult]:
    """Check the rig of a flight, or whether photos can be used; return each check's name, verdict, evidence and remedy.

    Args:
        source: a flight log, a recording (.mcap), a folder of photos, an opened source, or a simulated flight.
        seconds: length of the part of a flight that is read.
        start: begin of that part, s from the first exposure.
        settings: see `run`; its section `sources` is used only if `source` is a name.

    Raises:
        InputError: the input cannot be used, or has no exposure in that part.
        SettingsError: a setting cannot be used.
    """
    from alight.runner.checking import check_opened
    from alight.runner.opening import open_source

    chosen = settings_of(settings)
    with single_threaded_algebra():
        opened = open_source(source, chosen) if isinstance(source, str | Path) else source
        return check_opened(opened, chosen, seconds, start)


def demo(out: str | Path = "out/demo", seed: int = 1, progress: Progress = _quiet, overwrite: bool = False) -> Result:
    """Fly a simulated landing (search, look, look again from lower down, touch down) and write the folder `out`.

    Args:
        out: output folder; an earlier run in it is replaced.
        seed: seed of the ground and the flight.
        overwrite: whether to write into a folder that holds other files.

    Raises:
        OutputError: the folder holds other files and `overwrite` is false, or it cannot be written.
    """
    from alight.trials.demo import fly_demo

    with single_threaded_algebra():
        landing = fly_demo(Path(out), seed, Settings(), overwrite, progress)
    result = Result(landing.result)
    result.save(out, overwrite)
    return result


def campaign(
    scenes: Sequence[str],
    out: str | Path,
    *,
    landings: int | None = None,
    seed: int = 0,
    jobs: int = 1,
    scheduler: str | None = None,
    settings: SettingsLike = None,
) -> CampaignNumbers:
    """Fly simulated landings in closed loop; landings that the folder `out` already holds are not flown again.

    Args:
        scenes: names, scene files, `package.module:factory` of other worlds, or `all`.
        out: folder of the campaign.
        landings: total number of landings, including the landings in the folder; None: the number of the folder's
            campaign, or 20 for a new one.
        seed: seed of all random numbers.
        jobs: number of processes on this machine.
        scheduler: address of a Dask cluster, used instead of processes.
        settings: see `run`.

    Raises:
        AlightError: a scene does not exist, or the folder holds another campaign or more landings.
    """
    from alight.trials.campaign.run import Campaign, fly_campaign, wanted_landings

    planned = Campaign(scenes, wanted_landings(Path(out), landings), seed, settings_of(settings))
    return fly_campaign(planned, Path(out), jobs, scheduler)


def warmup(progress: Progress = _quiet) -> None:
    """Compile all loops, so that the first run does not wait for the compiler; `alight warmup` does it on all cores."""
    from alight.loop_forms import USES, compile_loops

    compile_loops(*USES, progress=progress, cores=1)


def train_appearance(folder: str | Path, out: str | Path, sampling: float = 0.05, progress: Progress = _quiet) -> str:
    """Train the appearance model on a folder of pictures by class, write it to `out`, and return its provenance.

    Args:
        sampling: metres per pixel of pictures without an entry in index.csv.

    Raises:
        AlightError: the pictures cannot be used, or the file cannot be written.
    """
    from alight.runner.appearance import train_to_file

    return train_to_file(Path(folder), Path(out), sampling, progress).model.provenance


def evaluate_appearance(
    folder: str | Path, model: str | Path | None = None, sampling: float = 0.05, progress: Progress = _quiet
) -> Confusion:
    """Compare the classes of an appearance model with labelled pictures; return the confusion matrix.

    Args:
        folder: pictures by class, or `images/` with `labels/`.
        model: file of a trained model; None: the model of the package.
        sampling: metres per pixel of pictures without an entry in index.csv.
        progress: called with the name of the stage and the share of it that is done.

    Raises:
        InputError: the pictures or the model cannot be used.
    """
    from alight.runner.appearance import judge_appearance

    return judge_appearance(Path(folder), None if model is None else Path(model), sampling, progress)
