"""The contract of a design's file: lengths in mm as on a drawing, everything inside in SI.

A file that says something impossible is refused with the key, the value and the reason.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import tomlkit
from msgspec import Meta, Struct

from edge_daemon.errors import BadInput
from edge_daemon.text import read_toml

Above0 = Annotated[float, Meta(gt=0)]
Thickness = Above0 | list[tuple[Annotated[float, Meta(ge=0)], Above0]]
"""One thickness, or (position, thickness) pairs that are joined by straight lines."""
MM = 1e-3
"""Files are in mm, the solver in m."""
LEAST_SPAN = 0.2
"""A straight piece of wall or diaphragm is at least this share of its thickness, so that elements fit."""


class DesignError(BadInput):
    """One line: which file, which key, what is wrong, what was expected."""


class Flexspline(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[flexspline]`: the section as drawn [mm]."""

    kind: Literal["cup", "silk_hat", "silk-hat", "pancake"] = "cup"
    mean_radius_mm: Above0
    """middle of the wall"""
    length_mm: Above0
    """from the open end to the diaphragm's outer face"""
    wall_mm: Thickness | None = None
    rim_width_mm: Above0 | None = None
    rim_thickness_mm: Above0
    diaphragm_thickness_mm: Thickness | None = None
    hub_radius_mm: Above0 | None = None
    fillet_mm: Above0 | None = None
    back_cone_deg: Annotated[float, Meta(ge=0, le=45)] = 0.0
    teeth_add_stiffness: bool = False
    """the toothed rim as a ring with a layer that is stiff along the axis only"""


class Toothing(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[teeth]`; `module_mm` follows from the rim where it is absent."""

    flexspline: Annotated[int, Meta(ge=20)]
    circular_spline: Annotated[int, Meta(ge=20)]
    module_mm: Above0 | None = None
    profile: Literal["involute", "S"] = "involute"
    pressure_angle_deg: Annotated[float, Meta(gt=5, lt=45)] | None = None


class Generator(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[wave_generator]`; `radial_deflection_mm` is that of the major axis."""

    shape: Literal["ellipse", "cosine", "four_force", "four-force", "double_disc", "double-disc", "measured"] = (
        "ellipse"
    )
    radial_deflection_mm: Above0 | None = None
    contact: Literal["one-sided", "line", "bore"] = "one-sided"
    contact_width_mm: Above0 | None = None
    bearing_stiffness_N_per_mm3: Above0 | None = None
    """pressure per closing; rigid where absent"""
    force_angle_deg: Annotated[float, Meta(gt=0, lt=45)] = 30.0
    """four-force: of each force from the major axis"""
    disc_eccentricity_mm: Above0 | None = None
    """double-disc: of each disc's centre"""
    contour: list[tuple[float, float]] | None = None
    """measured: (angle [deg], radius or deflection [mm])"""


class MaterialKeys(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[material]`: a name of the table, numbers, or a name with numbers of one's own in place of the table's."""

    name: str | None = None
    youngs_modulus_GPa: Above0 | None = None
    poisson: Annotated[float, Meta(ge=0, lt=0.5)] | None = None
    density_kg_m3: Above0 | None = None
    yield_MPa: Above0 | None = None
    ultimate_MPa: Above0 | None = None
    endurance_MPa: Above0 | None = None
    slope: Above0 | None = None
    """exponent of the S-N curve"""
    surface: str = "none"
    reliability: Annotated[float, Meta(ge=0.5, lt=1.0)] = 0.99


class Load(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[load]` at the output; `spectrum` is a history file or rows of torque [N m], speed [rpm] and share of time."""

    torque_Nm: Annotated[float, Meta(ge=0)] = 0.0
    speed_in_rpm: Annotated[float, Meta(ge=0)] = 2000.0
    spectrum: str | list[tuple[float, float, Above0]] | None = None
    stiffness_Nm_per_rad: Above0 | None = None
    """as measured on the gear that runs, to set beside the design's"""


class Wishes(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """`[optimise]`: F = w1 sigma_max [MPa] + w2 delta_max [mm] + w3 V [mm3], bounds and constraints."""

    weights: tuple[float, float, float] = (1.0, 500.0, 0.1)
    bounds: dict[str, tuple[float, float]] = {}
    shapes: list[str] = []
    """wave generator shapes to choose from; the file's own where empty"""
    safety_min: Annotated[float, Meta(ge=0)] = 1.0
    stiffness_min_Nm_per_rad: Annotated[float, Meta(ge=0)] = 0.0
    wall_min_mm: Annotated[float, Meta(ge=0)] = 0.1
    ratcheting_min_Nm: Annotated[float, Meta(ge=0)] = 0.0
    buckling_min_Nm: Annotated[float, Meta(ge=0)] = 0.0
    volume_max_mm3: Above0 | None = None
    assembly: bool = True
    """teeth stand clear of each other at the minor axis"""
    evaluations: Annotated[int, Meta(ge=20, le=20000)] = 400
    front_points: Annotated[int, Meta(ge=0, le=60)] = 9


class Drawing(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A whole file."""

    flexspline: Flexspline
    teeth: Toothing | None = None
    wave_generator: Generator
    material: MaterialKeys = MaterialKeys(name="40CrNiMoA")
    load: Load = Load()
    optimise: Wishes = Wishes()
    name: str = ""


ALIASES = {
    "material": {
        **dict.fromkeys(
            ("E_GPa", "young_GPa", "youngs_GPa", "young_modulus_GPa", "elastic_modulus_GPa"), "youngs_modulus_GPa"
        ),
        **dict.fromkeys(("nu", "poisson_ratio", "poissons_ratio"), "poisson"),
        **dict.fromkeys(("density", "density_kg_per_m3", "rho_kg_m3"), "density_kg_m3"),
        **dict.fromkeys(("yield_strength_MPa",), "yield_MPa"),
        **dict.fromkeys(("ultimate_strength_MPa", "tensile_MPa", "tensile_strength_MPa", "uts_MPa"), "ultimate_MPa"),
        **dict.fromkeys(("endurance_limit_MPa", "fatigue_limit_MPa", "fatigue_strength_MPa"), "endurance_MPa"),
        **dict.fromkeys(("treatment", "surface_treatment"), "surface"),
    }
}
"""Other words that data sheets have for the same number."""


def read_drawing(path: Path) -> Drawing:
    """The design of a TOML file, checked. Raises `DesignError` with one line."""
    document = read_toml(path, DesignError)
    try:
        return drawing_of(document)
    except DesignError as error:
        raise DesignError(f"{path}: {error}") from error


def drawing_of(document: Mapping[str, Any]) -> Drawing:
    """The design of a document's tables, checked."""
    try:
        drawing = msgspec.convert(_plain(document), Drawing)
    except msgspec.ValidationError as error:
        raise DesignError(_one_line(str(error))) from error
    check_drawing(drawing)
    return drawing


def _plain(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document with its aliases replaced."""
    tables = dict(document)
    for section, names in ALIASES.items():
        keys = tables.get(section)
        if isinstance(keys, Mapping):
            tables[section] = {names.get(key, key): value for key, value in keys.items()}
    return tables


def _one_line(message: str) -> str:
    """msgspec's `what - at `$.field`` as `field: what`."""
    found = re.fullmatch(r"(.*) - at `\$\.?(.*)`", message, re.DOTALL)
    if found and found.group(2):
        return f"{found.group(2)}: {found.group(1)}"
    named = re.fullmatch(r"Object missing required field `(.*)`", message)
    return f"[{named.group(1)}] is missing" if named else message


def weighted(drawing: Drawing, text: str) -> Drawing:
    """With the weights `W1,W2,W3` of a command line."""
    try:
        first, second, third = (float(part) for part in text.split(","))
    except ValueError as error:
        raise DesignError(f"--weights {text}: expected three numbers W1,W2,W3") from error
    wishes = msgspec.structs.replace(drawing.optimise, weights=(first, second, third))
    return msgspec.structs.replace(drawing, optimise=wishes)


def drawing_text(drawing: Drawing) -> str:
    """The file that says this design."""

    def known(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: known(inner) for key, inner in value.items() if inner is not None}
        return list(value) if isinstance(value, tuple) else value

    return tomlkit.dumps(known(msgspec.to_builtins(drawing)))


def check_drawing(drawing: Drawing) -> None:
    """Raises `DesignError` where the part could not be made or not be put together."""
    for value, where in _numbers(drawing):
        if not math.isfinite(value):
            raise DesignError(f"{where}: {value} is not a number that can be drawn")
    body, pancake = drawing.flexspline, drawing.flexspline.kind == "pancake"
    for name in () if pancake else ("wall_mm", "rim_width_mm", "diaphragm_thickness_mm", "hub_radius_mm", "fillet_mm"):
        if getattr(body, name) is None:
            raise DesignError(f"flexspline.{name} is missing: a {body.kind} needs it")
    _check_profiles(body)
    if body.rim_thickness_mm >= body.mean_radius_mm:
        raise DesignError(
            f"flexspline.rim_thickness_mm: {body.rim_thickness_mm:g} fills the bore of radius {body.mean_radius_mm:g}"
        )
    if not pancake:
        CupSection(body).check()
    _check_generator(drawing)
    if drawing.teeth:
        _check_teeth(drawing)


def _numbers(drawing: Drawing) -> Sequence[tuple[float, str]]:
    found: list[tuple[float, str]] = []

    def walk(value: Any, where: str) -> None:
        if isinstance(value, float):
            found.append((value, where))
        elif isinstance(value, Mapping):
            for key, inner in value.items():
                walk(inner, f"{where}.{key}" if where else str(key))
        elif isinstance(value, list | tuple):
            for inner in value:
                walk(inner, where)

    walk(msgspec.to_builtins(drawing), "")
    return found


def _check_profiles(body: Flexspline) -> None:
    for name in ("wall_mm", "diaphragm_thickness_mm"):
        profile = getattr(body, name)
        if isinstance(profile, list):
            places = [row[0] for row in profile]
            if not places or any(b <= a for a, b in itertools.pairwise(places)):
                raise DesignError(f"flexspline.{name}: expected pairs [position, thickness] with rising positions")


def _check_generator(drawing: Drawing) -> None:
    generator, body = drawing.wave_generator, drawing.flexspline
    if generator.shape == "measured":
        if not generator.contour or len(generator.contour) < 8:
            raise DesignError("wave_generator.contour: a measured shape needs at least 8 pairs [angle_deg, radial_mm]")
    elif generator.radial_deflection_mm is None:
        raise DesignError("wave_generator.radial_deflection_mm is missing")
    deflection = generator.radial_deflection_mm or 0.0
    if deflection > 0.1 * body.mean_radius_mm:
        raise DesignError(
            f"wave_generator.radial_deflection_mm: {deflection:g} is more than a tenth of the radius"
            f" {body.mean_radius_mm:g}: no linear theory holds there"
        )
    width = body.length_mm if body.kind == "pancake" else (body.rim_width_mm or 0.0)
    if generator.contact_width_mm is not None and generator.contact_width_mm > width + 1e-9:
        raise DesignError(
            f"wave_generator.contact_width_mm: {generator.contact_width_mm:g} is wider than the rim ({width:g})"
        )


def _check_teeth(drawing: Drawing) -> None:
    teeth, body = drawing.teeth, drawing.flexspline
    assert teeth is not None
    lobes = teeth.circular_spline - teeth.flexspline
    if lobes <= 0 or lobes % 2:
        raise DesignError(
            f"teeth.circular_spline: {teeth.circular_spline} beside {teeth.flexspline}: two lobes need"
            " 2 (or 4, ...) teeth more than the flexspline"
        )
    if teeth.module_mm is None:
        return
    outer = body.mean_radius_mm + 0.5 * wall_thickness_mm(body) * (body.kind != "pancake")
    outer += body.rim_thickness_mm - (
        wall_thickness_mm(body) if body.kind != "pancake" else 0.5 * body.rim_thickness_mm
    )
    pitch_radius = 0.5 * teeth.module_mm * teeth.flexspline
    if not 0.85 < pitch_radius / outer < 1.25:
        raise DesignError(
            f"teeth.module_mm: {teeth.flexspline} teeth of module {teeth.module_mm:g} have a pitch radius of"
            f" {pitch_radius:.4g} mm, and the rim's outer radius is {outer:.4g}: they do not fit on each other"
        )


def wall_thickness_mm(body: Flexspline) -> float:
    """The wall's thickness, of a profile its mean between the rim and the diaphragm."""
    if body.wall_mm is None:
        return body.rim_thickness_mm
    if isinstance(body.wall_mm, float | int):
        return float(body.wall_mm)
    ends = (body.rim_width_mm or 0.0, body.length_mm)
    samples = [ends[0] + (ends[1] - ends[0]) * (k + 0.5) / 50 for k in range(50)]
    return sum(thickness_at(body.wall_mm, place) for place in samples) / 50


def thickness_at(profile: Thickness, place: float) -> float:
    """Of a profile at a place, straight between its points and constant beyond them [mm]."""
    if isinstance(profile, float | int):
        return float(profile)
    first = profile[0]
    if place <= first[0]:
        return first[1]
    for (a, ta), (b, tb) in itertools.pairwise(profile):
        if place <= b:
            return ta + (tb - ta) * (place - a) / (b - a)
    return profile[-1][1]


@dataclass(frozen=True, slots=True)
class CupSection:
    """Points of a cup's or a hat's meridian section [mm]: z from the open end, radius from the axis.

    `side` is -1 where the diaphragm goes inwards to a hub, +1 where it goes outwards to a flange.
    """

    body: Flexspline

    @property
    def side(self) -> int:
        return -1 if self.body.kind == "cup" else 1

    @property
    def bore(self) -> float:
        return self.body.mean_radius_mm - 0.5 * wall_thickness_mm(self.body)

    def wall(self, z: float) -> float:
        """Thickness at z."""
        assert self.body.wall_mm is not None
        return thickness_at(self.body.wall_mm, z)

    def diaphragm(self, radius: float) -> float:
        """Thickness at a radius."""
        assert self.body.diaphragm_thickness_mm is not None
        return thickness_at(self.body.diaphragm_thickness_mm, radius)

    @property
    def rim_width(self) -> float:
        return self.body.rim_width_mm or self.body.length_mm

    @property
    def hub(self) -> float:
        return self.body.hub_radius_mm or 0.0

    @property
    def slope(self) -> float:
        """Tangent of the back cone's angle."""
        return math.tan(math.radians(self.body.back_cone_deg))

    def step(self) -> tuple[float, float, float, float]:
        """Of the 45 degree step: (thickness of the wall behind, fillet radius, z of the fillet's two ends).

        A fillet too large for a low step is drawn as large as the step lets it be.
        """
        body, wall = self.body, self.wall(self.rim_width)
        tangent = fillet = 0.0
        for _ in range(5):
            height = body.rim_thickness_mm - wall
            if height <= 1e-9:
                return wall, 0.0, self.rim_width, self.rim_width
            fillet = min(body.fillet_mm or 0.0, 0.95 * height * math.sqrt(2) / math.tan(math.pi / 8))
            tangent = fillet * math.tan(math.pi / 8)
            wall = self.wall(self.rim_width + height + tangent)
        base = self.rim_width + body.rim_thickness_mm - wall
        return wall, fillet, base - tangent / math.sqrt(2), base + tangent

    def corner(self) -> tuple[float, float]:
        """Where the fillet between wall and diaphragm begins on the wall, and its radius of the diaphragm's end."""
        fillet, cone = self.body.fillet_mm or 0.0, math.radians(self.body.back_cone_deg)
        reach = fillet * math.tan(0.5 * (0.5 * math.pi - cone))
        line = self.bore if self.side < 0 else self.bore + self.wall(self.body.length_mm)
        return self.inner_face(line) - reach, line + self.side * reach * math.cos(cone)

    def outer_face(self, radius: float) -> float:
        """z of the diaphragm's outer face."""
        edge = self.bore + (self.wall(self.body.length_mm) if self.side < 0 else 0.0)
        return self.body.length_mm + self.side * (radius - edge) * self.slope

    def inner_face(self, radius: float) -> float:
        """z of the face that looks to the open end; the thickness is at right angles to the faces."""
        thick = self.diaphragm(radius) / math.cos(math.radians(self.body.back_cone_deg))
        return self.outer_face(radius) - thick

    def check(self) -> None:
        """Raises `DesignError` where the pieces of the section do not fit."""
        body, wall = self.body, self.wall(self.rim_width)
        if body.rim_thickness_mm < wall - 1e-9:
            raise DesignError(
                f"flexspline.rim_thickness_mm: {body.rim_thickness_mm:g} is thinner than the wall behind it ({wall:g})"
            )
        if body.rim_width_mm and body.rim_width_mm >= body.length_mm:
            raise DesignError(
                f"flexspline.rim_width_mm: {body.rim_width_mm:g} is not below length_mm ({body.length_mm:g})"
            )
        begin, end = self.step()[3], self.corner()[0]
        if end - begin < LEAST_SPAN * wall:
            raise DesignError(
                f"flexspline.length_mm: {body.length_mm:g} leaves no wall between the rim's step, which ends at"
                f" {begin:.4g} mm, and the diaphragm's fillet, which begins at {end:.4g} mm"
            )
        self._check_hub()

    def _check_hub(self) -> None:
        body, edge = self.body, self.corner()[1]
        if self.side < 0 and self.hub >= self.bore:
            raise DesignError(f"flexspline.hub_radius_mm: {self.hub:g} is not inside the bore ({self.bore:.4g})")
        outside = self.bore + self.wall(body.length_mm)
        if self.side > 0 and self.hub <= outside:
            raise DesignError(
                f"flexspline.hub_radius_mm: {self.hub:g}: a silk hat is clamped outside its wall ({outside:.4g})"
            )
        if self.side * (self.hub - edge) < LEAST_SPAN * self.diaphragm(self.hub):
            raise DesignError(
                f"flexspline.fillet_mm: {body.fillet_mm:g} leaves no diaphragm between the fillet's end at radius"
                f" {edge:.4g} mm and the hub at {self.hub:g} mm"
            )
        if self.side < 0 and self.inner_face(self.bore) <= self.rim_width:
            raise DesignError("flexspline.diaphragm_thickness_mm: it reaches into the rim")
