# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Base poses with their files and their training."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from mocap_ros.api.arguments import read_joint_names, read_numbers, read_path
from mocap_ros.config import format_value
from mocap_ros.errors import InputError, ModelError, name_errors
from mocap_ros.formats.text_files import replace_output
from mocap_ros.models import base_poses, model_file
from mocap_ros.skeleton import CMU15, canonical_joint_names
from mocap_ros.training.fit_base_poses import fit_base_poses


class BasePoses(base_poses.PoseModel):
    """Base poses: the mean pose and the directions in which poses vary, learned from motion capture.

    Create them by `load` or `fit`. J = 15 joints of the layout `cmu15`, K base poses; poses are in metres in the
    body frame: x forward, y left, z up, with the mean of the joints as origin.

    Attributes:
        name: motion category that the model was trained for (`walk`, `run`, `jump`, ... or `all`).
        mean: (J, 3) m, mean pose.
        components: (K, J, 3) base poses, orthonormal, in order of decreasing variance.
        std: (K,) m, standard deviation of the weight of each base pose over the training poses.
        explained: (K,) cumulative share of the variance.
        stature: m, mean stature of the people in the training data.
        provenance: origin of the training data and settings of the training.
    """

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(J,) names of the joints."""
        return self.skeleton.joints

    @classmethod
    def load(cls, name_or_path: str | Path) -> BasePoses:
        """Load shipped base poses (`all`, `walk`, `run`, `jump`) by name, or others from a model file.

        Raises:
            ModelError: no model has this name and no file this path, or the file is not a model.
        """
        read_path('name_or_path', name_or_path, ModelError)
        return cls._extend(model_file.load_base_poses(name_or_path))

    @classmethod
    def fit(
        cls,
        trials: Sequence[ArrayLike],
        *,
        name: str,
        joint_names: Sequence[str] | str = 'cmu15',
        components: int = 45,
        alignment: Literal['rotation', 'heading'] = 'rotation',
        mirror: bool = False,
        bodies: int = 0,
        provenance: Mapping[str, object] | None = None,
    ) -> BasePoses:
        """Learn base poses from motion capture (TPAMI 2016, section 4.1, with poses aligned first).

        Args:
            trials: arrays (F_i, J, 3) in m, z up, one for each recording. 30 frames per second are enough.
            name: motion category of the model.
            joint_names: (J,) names of the joints, which include those of `cmu15` in any order, or the name of a
                layout.
            components: largest number of base poses.
            alignment: `rotation` aligns poses by any rotation, for all kinds of motion; `heading` turns them about
                the vertical only, for one kind of upright motion.
            mirror: True to add the mirror image of every pose.
            bodies: number of bodies with random bone lengths to which each trial is transferred in addition.
            provenance: origin of the data, to be saved with the model; values that JSON can hold. What the
                training states itself, such as `alignment`, replaces entries of the same name.

        Raises:
            InputError: an argument is not valid; the error names it.
            SkeletonError: no layout has the name given as `joint_names`.
            ModelError: there are fewer than two poses, a trial does not hold finite poses of a person in metres,
                or the poses do not vary; or `name` or `provenance` cannot be saved.
        """
        if not isinstance(name, str) or not 0 < len(name) <= model_file.MAX_NAME_LENGTH:
            raise ModelError(f'name: expected a text of 1 to {model_file.MAX_NAME_LENGTH} characters')
        try:
            json.dumps(dict(provenance or {}))
        except (TypeError, ValueError, RecursionError) as error:
            raise ModelError(f'provenance: expected values by name that JSON can hold: {error}') from None
        counts: tuple[tuple[str, object, int], ...] = (('components', components, 1), ('bodies', bodies, 0))
        for argument, count, least in counts:
            if not isinstance(count, int | np.integer) or count < least:
                raise InputError(f'{argument}: {count!r}, expected a whole number of at least {least}')
        if alignment not in ('rotation', 'heading'):
            raise InputError(f'alignment: {alignment!r}, expected rotation or heading')
        names = canonical_joint_names(read_joint_names('joint_names', joint_names))
        if missing := [joint for joint in CMU15.joints if joint not in names]:
            raise InputError(f'joint_names: {", ".join(missing)} missing')
        if not isinstance(trials, Iterable):
            raise ModelError(f'trials: {format_value(trials)}, expected a sequence of arrays (F, J, 3)')
        order = [names.index(joint) for joint in CMU15.joints]
        motions = []
        for i, trial in enumerate(trials):
            motions.append(read_numbers(f'trials[{i}]', trial, (None, len(names), 3))[:, order])
            if not len(motions[i]):
                raise InputError(f'trials[{i}]: no frames')
        with name_errors('trials'):
            model = fit_base_poses(
                motions,
                name=name,
                components=int(components),
                alignment=alignment,
                mirror=mirror,
                bodies=int(bodies),
                provenance=provenance,
            )
        return cls._extend(model)

    def save(self, path: str | Path) -> None:
        """Write a model file (.npz), which `load` and the parameter `tracker.model` accept.

        Raises:
            InputError: `path` is no path.
            MocapError: the file cannot be written.
        """
        path = read_path('path', path)
        with replace_output(path) as unfinished:
            model_file.save_base_poses(self, unfinished)

    @classmethod
    def _extend(cls, model: base_poses.PoseModel) -> BasePoses:
        return cls(**{field.name: getattr(model, field.name) for field in fields(base_poses.PoseModel)})

    def __repr__(self) -> str:
        ten = self.explained[min(9, len(self.explained) - 1)]
        return (
            f'BasePoses {self.name!r}: {len(self.std)} base poses of {len(self.mean)} joints, stature '
            f'{self.stature:.2f} m; the first {min(10, len(self.std))} explain {ten:.1%} of the variance'
        )
