"""Curves of a take, with its events and labels, in one call."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from .frames import USABLE

if TYPE_CHECKING:
    from .take import Take

UNITS = {"_deg": "degrees", "_m_s": "m/s", "_rad_s": "rad/s", "_m": "m"}
# Of many joints these say most at a glance.
FIRST = ("elbow_r_flexion_deg", "elbow_l_flexion_deg", "knee_r_flexion_deg", "knee_l_flexion_deg", "hip_r_flexion_deg", "hip_l_flexion_deg")


class Picture(Figure):
    """A figure that notebooks show by themselves, without a global one of `pyplot`."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png")
        return file.getvalue()


def curve(take: Take[Any], name: str) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Times and values of a column of `body`, or by `SENSOR.COLUMN` of `sensors`; NaN where a pose is not to be used."""
    sensor, dot, column = name.rpartition(".")
    if not dot:
        body = take.table("body")
        if name not in body:
            raise KeyError(f"no column {name!r} of the body; a sensor's is SENSOR.COLUMN, as wand.x_m")
        return body["t_s"], body[name]
    table = take.table("sensors")
    own = table["sensor"] == sensor
    if column not in table or not own.any():
        raise KeyError(f"no column {column!r}, or no sensor {sensor!r}")
    usable = np.isin(table["state"][own].astype(str), list(USABLE))
    return table["t_s"][own], np.where(usable, table[column][own], np.nan)


def likeliest(take: Take[Any]) -> tuple[str, ...]:
    """Flexions where somebody wears sensors, else where the sensors went."""
    body = take.table("body")
    angles = [name for name in FIRST if name in body and np.isfinite(body[name]).any()]
    if angles:
        return tuple(angles)
    table = take.table("sensors")
    posed = table["sensor"][np.isfinite(table["x_m"])]
    return tuple(f"{sensor}.{axis}_m" for sensor in dict.fromkeys(posed) for axis in "xyz")


def unit_of(name: str) -> str:
    return next((unit for end, unit in UNITS.items() if name.endswith(end)), "")


def plot(take: Take[Any], columns: tuple[str, ...]) -> Figure:
    names = columns or likeliest(take)
    units = list(dict.fromkeys(unit_of(name) for name in names)) or [""]
    figure = Picture(figsize=(10, 1 + 2.5 * len(units)), layout="constrained")
    axes = figure.subplots(len(units), 1, sharex=True, squeeze=False)[:, 0]
    labels, events = take.table("labels"), take.table("events")
    for axis, unit in zip(axes, units, strict=True):
        for name in names:
            if unit_of(name) == unit:
                t_s, values = curve(take, name)
                axis.plot(t_s, values, linewidth=1, label=name)
        axis.set_ylabel(unit)
        for from_s, to_s in zip(labels["from_s"], labels["to_s"], strict=True):
            axis.axvspan(from_s, to_s, alpha=0.1)
        for t_s in events["t_valid_s"][events["topic"] == "marks"]:
            axis.axvline(t_s, color="black", linestyle=":")
        if names:
            axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small")
    top = axes[0]
    for from_s, label in zip(labels["from_s"], labels["label"], strict=True):
        top.text(from_s, 1.0, label, transform=top.get_xaxis_transform(), fontsize="small", va="bottom")
    for t_s, label, topic in zip(events["t_valid_s"], events["label"], events["topic"], strict=True):
        if topic == "marks":
            top.text(t_s, 1.0, label, transform=top.get_xaxis_transform(), fontsize="small", va="bottom")
    axes[-1].set_xlabel("capture time, s")
    figure.suptitle(f"{take.stage}: {take.path.name}")
    return figure
