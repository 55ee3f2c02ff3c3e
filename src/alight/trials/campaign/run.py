"""Fly a campaign: the landings that are not done yet, one line per landing, and the report at the end."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from alight import __version__
from alight.cluster import sources_digest
from alight.documents import DocumentError, read_bytes
from alight.outputs.atomic_write import write_whole
from alight.records import AlightError, InputError
from alight.records.campaign import LARGEST_SEED, MOST_LANDINGS, CampaignHead, Conditions, LandingRecord
from alight.records.telemetry import FirmwareName
from alight.report.canvas import embedded
from alight.runs import appearance_of
from alight.settings import Settings, settings_of_run
from alight.trials.campaign.flying import FlyLanding, checked_vehicle, fly_all, fly_conditions
from alight.trials.campaign.folder import HEAD, PAGE, CampaignFolder
from alight.trials.campaign.numbers import CampaignNumbers, campaign_numbers
from alight.trials.campaign.page import render_campaign
from alight.trials.campaign.plan import conditions_of
from alight.trials.campaign.worlds import file_digests, scenes_of
from alight.trials.landing import fly_landing
from alight_sim.campaign import campaign_worlds

log = logging.getLogger(__name__)


class Ended(NamedTuple):
    """A landing that has ended, and the progress of the campaign."""

    record: LandingRecord
    done: int  # number of landings that have ended
    of: int  # number of landings of the campaign
    left_s: float  # estimated seconds until the campaign ends


@dataclass(frozen=True)
class Campaign:
    """Everything that the results of a campaign depend on.

    Raises:
        InputError: there is no such scene, the number of landings is out of range, or the seed is too large.
    """

    scenes: Sequence[str]  # names, files, or `all`
    landings: int
    seed: int
    settings: Settings
    link_faults: float = 0.0  # share of the landings with a fault of the link or the autopilot
    firmware: FirmwareName = "ardupilot"
    odometry: bool = False  # whether odometry is sent, and GPS fails in each landing
    people: float = 0.0  # share of the landings in which a person or car comes

    def __post_init__(self) -> None:
        if not 1 <= self.landings <= MOST_LANDINGS:
            raise InputError(f"a campaign of {self.landings} landings; give 1 to {MOST_LANDINGS}")
        if not 0 <= self.seed <= LARGEST_SEED:
            raise InputError(f"a campaign of seed {self.seed}; give 0 to {LARGEST_SEED}")
        object.__setattr__(self, "scenes", scenes_of(self.scenes))

    def conditions(self, landing: int) -> Conditions:
        """Draw the conditions of the landing with this number."""
        return conditions_of(
            self.scenes, self.seed, landing, self.link_faults, self.firmware, self.odometry, self.people
        )

    @property
    def head(self) -> CampaignHead:
        """Head of campaign.json, which identifies the campaign."""
        settings = self.settings.model_dump(mode="json")
        return CampaignHead(
            alight=__version__, seed=self.seed, scenes=tuple(self.scenes), landings=self.landings, settings=settings,
            link_faults=self.link_faults, firmware=self.firmware, odometry=self.odometry, people=self.people,
            sources=sources_digest(), files=file_digests(self.scenes, self.settings),
        )  # fmt: skip

    def check(self) -> None:
        """Check that landings can begin: the first landing, and one landing in each scene file.

        Raises:
            InputError: a landing cannot begin; the message names the scene, the lander or the model of appearance.
        """
        known = campaign_worlds()
        appearance_of(self.settings)
        for k, scene in enumerate(self.scenes):
            if k == 0 or scene not in known:
                checked_vehicle(self.conditions(k), self.settings)


def wanted_landings(out: Path, wanted: int | None) -> int:
    """Return the number of landings of a campaign: `wanted`, else the number in the folder's campaign, else 20.

    Raises:
        InputError: the folder's campaign.json is damaged, or its campaign has more landings than `wanted`.
    """
    head = CampaignFolder(out).head()
    if head is None:
        return 20 if wanted is None else wanted
    if wanted is not None and wanted < head.landings:
        raise InputError(f"{out}: its campaign has {head.landings} landings; give as many or more, not {wanted}")
    return head.landings if wanted is None else wanted


def continued(out: Path, landings: int | None = None) -> Campaign:
    """Return the campaign of a folder, to continue it or to report it again.

    Args:
        out: folder of the campaign.
        landings: new number of landings; None: the number with which the campaign was begun.

    Raises:
        InputError: the folder holds no campaign, its scenes or settings cannot be used any more, or it has more
            landings.
    """
    folder = CampaignFolder(out)
    head = folder.head()
    if head is None:
        raise InputError(f"{out}: holds no campaign; name scenes, or 'all', to begin one")
    try:
        settings = settings_of_run(head.settings)
    except ValueError as e:
        raise InputError(f"{out / HEAD}: its settings are damaged: {e}") from e
    number = wanted_landings(out, landings)
    return Campaign(
        head.scenes, number, head.seed, settings, head.link_faults, head.firmware, head.odometry, head.people
    )


def fly_campaign(
    campaign: Campaign,
    out: Path,
    jobs: int = 1,
    scheduler: str | None = None,
    beside: Path | None = None,
    on_ended: Callable[[Ended], None] = lambda ended: None,
    fly: FlyLanding = fly_landing,
) -> CampaignNumbers:
    """Fly the landings that the folder does not hold yet, and write the report, also after an interruption.

    Args:
        campaign: the campaign to fly.
        out: folder of the campaign; an interrupted campaign is continued.
        jobs: number of processes of this machine.
        scheduler: address of a Dask cluster to use instead.
        beside: folder of another campaign, for a table of both.
        on_ended: called whenever a landing ends.
        fly: replaces `fly_landing` in tests.

    Raises:
        OutputError: the folder holds another campaign, or cannot be written.
        InputError: the folder's lines are damaged, no scheduler answers, or landings cannot begin.
    """
    if beside is not None:
        numbers_in(beside)  # a wrong name is reported before hours of work
    campaign.check()
    head, folder = campaign.head, CampaignFolder(out)
    folder.begin(head)
    try:
        done = {k for k, r in folder.read().items() if not r.was_lost}
        drawn = [campaign.conditions(k) for k in range(campaign.landings) if k not in done]
        job = partial(fly_conditions, settings=campaign.settings, fly=fly)
        begun, before = time.monotonic(), campaign.landings - len(drawn)
        try:
            for n, (record, picture, film) in enumerate(fly_all(drawn, job, jobs, scheduler), 1):
                folder.write_picture(record.film, film)
                folder.append(record, picture)
                each = (time.monotonic() - begun) / n
                on_ended(Ended(record, before + n, campaign.landings, each * (len(drawn) - n)))
        except BaseException:  # Ctrl-C, a full disk, a worker that cannot be had
            try:
                _report(folder, head, beside)
            except AlightError as e:
                log.warning("the report is not written: %s", e)
            raise
        return _report(folder, head, beside)
    finally:
        folder.end()


def _report(folder: CampaignFolder, head: CampaignHead, beside: Path | None) -> CampaignNumbers:
    """Write campaign.json and campaign.html, compared with the campaign in `beside` if given; return the numbers."""
    records = list(folder.read().values())
    numbers = campaign_numbers(records)
    other = None if beside is None else (beside.resolve().name, numbers_in(beside))
    folder.write_head(head, {"numbers": asdict(numbers)})
    pictures = _pictures(folder.out, [r.picture for r in records] + [r.film for r in records])
    page = render_campaign(folder.out.resolve().name, head, records, numbers, pictures, other)
    write_whole(folder.out / PAGE, page.encode())
    return numbers


def _pictures(out: Path, names: Sequence[str | None], most: int = 6_000_000) -> dict[str, str]:
    """Return data URIs by file name, in this order until `most` characters are reached; the page links the others."""
    found: dict[str, str] = {}
    for name in filter(None, names):
        if sum(map(len, found.values())) > most:
            break
        try:
            found[name] = embedded(read_bytes(out / name, 1_000_000))
        except (OSError, DocumentError) as e:
            why = "the report shows no picture of that touchdown or its looks"
            log.warning("%s: cannot be read (%s); %s", out / name, e, why)
    return found


def numbers_in(out: Path) -> CampaignNumbers:
    """Return the statistics of the campaign in a folder.

    Raises:
        InputError: the folder holds no campaign.
    """
    folder = CampaignFolder(out)
    if folder.head() is None:
        raise InputError(f"{out}: holds no campaign; name a folder that 'alight campaign' left")
    return campaign_numbers(list(folder.read().values()))


class Again(NamedTuple):
    """A landing that was flown again, compared with its line in the folder."""

    record: LandingRecord
    differing: list[str]  # names of the fields that are not the same
    not_compared: str | None  # reason why there was no line to compare with; None: there was one


def again(campaign: Campaign, out: Path, landing: int, fly: FlyLanding = fly_landing) -> Again:
    """Fly one landing once more, and compare it with its line in the folder; nothing is written.

    Raises:
        InputError: the folder's campaign is damaged; this is raised before the flight.
    """
    folder = CampaignFolder(out)
    there, why, old = folder.head(), "holds no campaign", None
    if there is not None:
        other = there.differing(campaign.head)
        old = folder.read().get(landing) if other is None else None
        why = f"holds a campaign with {other}" if other is not None else f"holds no line of landing {landing}"
    record = fly_conditions(campaign.conditions(landing), campaign.settings, fly).record
    if old is None:
        return Again(record, [], f"{out}: {why}")
    one, two = record.repeatable(), old.repeatable()
    return Again(record, [name for name in one if one[name] != two[name]], None)


def outcome_lines(numbers: CampaignNumbers) -> list[str]:
    """Return the outcomes as lines of text, one per outcome, and a line with the bounds of unsafe landings."""
    lines = [f"{name:<16} {count}" for name, count in numbers.outcomes.items()]
    return [
        *lines,
        f"unsafe landings: at most {100 * numbers.bound:.2g} % with 95 % confidence; on unsafe ground: "
        f"{numbers.unsafe_ground}, at most {100 * numbers.ground_bound:.2g} %",
    ]
