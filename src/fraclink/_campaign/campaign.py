"""The campaign as a noun: everything its result depends on, in one folder, and nothing else."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from fraclink._arm.link import LinkModel
from fraclink._arm.rig import Rig
from fraclink._campaign.draws import Distribution, Draws, draws_for
from fraclink._design.files import link_from
from fraclink._files import read_json, write_json
from fraclink._law import Law, equip
from fraclink._validate import checked_between, checked_choice, checked_noun
from fraclink.errors import FieldError, FileFormatError, SizeError

__all__ = ["PART_RUNS", "Campaign", "load_campaign", "save_campaign"]

KIND, FORMAT = "campaign", 1
PART_RUNS = 1000  # runs of a part: a second of work is what a kill can cost, and a file of 100 kB
LARGEST = 10**9  # runs; a year of one core is a slip of the pen
DURATION = 4.0  # [s]: three seconds of rest after the longest move, twenty vibration periods
SHAPES = (0.5, 0.75, 1.0)  # durations of the drawn moves [s]


@dataclass(frozen=True)
class Campaign:
    """Monte Carlo runs of one law on arms that differ: payload, stiffness, λ, motor, friction, sensors.

    rig, model and law: the nominal arm and the law under test (equipped with its inner loop for
    ``inner="sampled"``). draws: the distributions. runs: how many, 1 … 10⁹. seed: 0 … 2⁶³ − 1; the same
    seed gives the same runs whatever the number of workers. duration [s] of each run.
    """

    rig: Rig
    model: LinkModel
    law: Law
    draws: Draws
    runs: int
    seed: int = 0
    inner: str = "sampled"
    duration: float = DURATION

    def __post_init__(self) -> None:
        checked_noun("rig", self.rig, Rig, remedy="Rig.named or Rig.load make one")
        checked_noun("model", self.model, LinkModel, remedy="fit.model, or rig.model")
        checked_noun("law", self.law, Law, remedy="controller.discretize(rig.period) makes one")
        checked_noun("draws", self.draws, Draws, remedy="draws_for(rig, model)")
        for name, low, high in (("runs", 1, LARGEST), ("seed", 0, 2**63 - 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < low:
                raise FieldError(
                    name,
                    value,
                    "not a whole number in range",
                    allowed=f"{low} … {high}",
                    remedy="give a whole number",
                )
            if value > high:
                raise SizeError(name, value, "too many", allowed=f"<= {high}", remedy="ask for less")
        checked_choice("inner", self.inner, ("ideal", "sampled"), remedy='say "sampled"')
        duration = checked_between(
            "duration",
            self.duration,
            max(SHAPES) + 1.0,
            600.0,
            "s",
            remedy="leave time to settle after the longest move",
        )
        object.__setattr__(self, "duration", duration)
        if self.model.structure not in ("UD-FOM", "UD-IOM"):
            raise FieldError(
                "model",
                self.model.structure,
                "not one that the campaign draws",
                allowed="UD-FOM or UD-IOM",
                remedy="fit UD-FOM to the log",
            )

    @property
    def parts(self) -> int:
        """Number of parts of 1000 runs; the last one may be shorter."""
        return -(-self.runs // PART_RUNS)

    def part_runs(self, part: int) -> int:
        """Number of runs of part `part`, 0 … parts − 1."""
        return min(PART_RUNS, self.runs - part * PART_RUNS)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of everything a part's result depends on; the number of runs is not among it."""
        text = json.dumps(_about(self), sort_keys=True) + self.law.digest
        return hashlib.sha256(text.encode()).hexdigest()

    @staticmethod
    def of(
        rig: Rig,
        model: LinkModel,
        law: Law,
        *,
        runs: int,
        seed: int = 0,
        draws: Draws | None = None,
        inner: str = "sampled",
    ) -> Campaign:
        """Return the campaign of a law with the default draws of its rig; the law gets the rig's motor loop.

        >>> import fraclink as fl
        >>> rig = fl.Rig.named("paper-2023")
        >>> law = fl.Controller(gain=0.069876, order=0.612197, link=rig.model).discretize(rig.period, order=4)
        >>> Campaign.of(rig, rig.model, law, runs=2500).parts
        3
        """
        checked_noun("law", law, Law, remedy="controller.discretize(rig.period) makes one")
        checked_choice("inner", inner, ("ideal", "sampled"), remedy='say "sampled"')
        equipped = equip(law, rig, model) if inner == "sampled" and law.drive is None else law
        chosen = draws_for(rig, model) if draws is None else draws
        return Campaign(rig, model, equipped, chosen, runs, seed, inner)


def _about(campaign: Campaign) -> dict[str, object]:
    return {
        # as release 0.1 called the table, so that its folders can be resumed
        "rig": campaign.rig.to_toml().replace("[motor_loop]", "[inner_loop]"),
        "model": _stated(campaign.model),
        "draws": asdict(campaign.draws),
        "seed": campaign.seed,
        "inner": campaign.inner,
        "duration": campaign.duration,
        "part_runs": PART_RUNS,
        "shapes": list(SHAPES),
    }


# Fields of a link that release 0.1 did not have.
_LATER = {"gauge_delay", "gauge_gain", "second_mode", "unseen_up_to", "intervals"}


def _stated(model: LinkModel) -> dict[str, object]:
    """The link without later fields at their defaults: a campaign begun before them keeps its fingerprint."""
    default = {item.name: item.default for item in fields(LinkModel)}
    return {k: v for k, v in asdict(model).items() if k not in _LATER or v != default[k]}


def save_campaign(campaign: Campaign, folder: Path) -> None:
    """Write rig.toml, law.json and campaign.json into `folder`: all that a worker needs."""
    folder.mkdir(parents=True, exist_ok=True)
    campaign.rig.save(folder / "rig.toml")
    campaign.law.save(folder / "law.json")
    about = _about(campaign)
    about.pop("rig")
    record = about | {"runs": campaign.runs, "fingerprint": campaign.fingerprint}
    write_json(folder / "campaign.json", KIND, FORMAT, record)


def load_campaign(folder: Path | str) -> Campaign:
    """Read back what `save_campaign` wrote; FileFormatError where a file is damaged or does not belong."""
    place = Path(folder)
    data = read_json(place / "campaign.json", KIND, (FORMAT,))
    try:
        campaign = Campaign(
            rig=Rig.load(place / "rig.toml"),
            model=link_from(data["model"]),
            law=Law.load(place / "law.json"),
            draws=Draws(**{name: Distribution(**d) for name, d in data["draws"].items()}),
            runs=data["runs"],
            seed=data["seed"],
            inner=data["inner"],
            duration=data["duration"],
        )
    except (KeyError, TypeError) as error:
        raise FileFormatError(
            "campaign", str(error), "missing or unknown", allowed="a campaign's folder", remedy="start anew"
        ) from error
    if data.get("fingerprint") != campaign.fingerprint:
        raise FileFormatError(
            "fingerprint",
            data.get("fingerprint"),
            "not that of the folder's rig, law and draws",
            allowed=campaign.fingerprint,
            remedy="do not edit a campaign's files; start a new folder",
        )
    return campaign
