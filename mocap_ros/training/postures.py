# Copyright 2026 mocap_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Postures that motion capture hardly holds: seated, kneeling, lying, on the hands, with arms held in many ways.

    thigh, shank: (cos d sin a, +-sin d, -cos d cos a)
    elbow: S + e u + sqrt(l^2 - e^2) n,    u = (W - S) / |W - S|,    e = (l^2 - m^2 + |W - S|^2) / 2 |W - S|

A posture is a row of `POSTURES`. Angles are in degrees in the body's axes (x forward, y left, z up): a is 0 where
a limb hangs down and positive where its end is in front, d is positive outwards. The wrist W of a posed arm is at
one of `PLACES`, and its elbow follows from the lengths l and m of upper arm and forearm; n is perpendicular to u,
on the side to which the elbow points. Last, the body is laid down or turned upside down, and tilted until what it
rests on is level. Angles and hands move slowly in half of the examples. Bodies of which a limb is inside the trunk
or the other leg, or below what they rest on, stay as they were.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from mocap_ros.skeleton import BODY26, CORE_COUNT
from mocap_ros.training.example_arrays import (
    AGO,
    Array,
    Bools,
    RandomArrays,
    add_bones,
    axis_rotations,
    find_trunks,
    normalise,
    read_table,
    rotate_points,
    rotations_from_vectors,
)

Integers = NDArray[np.intp]

FACE = ('nose', 'leye', 'reye', 'lear', 'rear')
FEET = ('ltoe', 'rtoe', 'lheel', 'rheel')
HANDS = ('lhand', 'rhand')

# Joints that move with a limb; the joint at which the limb begins is not among them.
_OF_A_SIDE = {
    'arm': ('elbow', 'wrist', 'hand'),
    'leg': ('knee', 'ankle', 'toe', 'heel'),
    'forearm': ('wrist', 'hand'),
    'shank': ('ankle', 'toe', 'heel'),
    'foot': ('toe', 'heel'),
    'hand': ('hand',),
}
LIMBS = {s + limb: tuple(s + j for j in joints) for limb, joints in _OF_A_SIDE.items() for s in 'lr'}
LIMBS['head'] = ('head', *FACE)

# Directions of a leg in degrees: a and d of the thigh and of the shank, and by how much the toes point down. A
# shank of `level` ends at the height of the hip, on the floor for a person who sits on it.
LEGS = """
name       thigh    out      shank     out      toes
bent_over  -20:30   -5:25    -35:5     -15:8    -15:20
crouching  50:125   -5:30    -55:5     -15:8    -15:50
chair      65:108   -5:30    -50:80    -15:8    -15:35
steady     72:90    -10:15   -10:25    -8:8     -10:15
crossed    97:115   -25:-10  5:65      -15:10   0:40
figure4    88:105   35:60    30:80     -85:-65  -10:30
forward    58:95    -5:20    35:85     -12:8    -10:35
over       68:118   -12:5    48:108    -28:-8   0:45
under      60:108   -12:5    38:98     -28:-8   0:45
propped    75:125   -5:25    62:115    -12:8    -10:40
stretched  82:95    -3:30    80:93     -5:25    -10:40
cross      76:96    35:65    80:100    -85:-65  0:50
knees_up   100:155  -8:25    level     -15:10   -10:30
tailor     76:96    35:65    -100:-80  -80:-50  0:50
side_far   82:97    -5:25    -106:-86  10:45    20:65
kneeling   -20:30   -5:20    -105:-75  -10:10   35:68
foot_flat  82:108   -5:20    -20:15    -8:8     -10:10
heels      72:98    0:30     -104:-84  -10:5    45:68
straight   -8:8     -3:25    -12:5     -5:25    10:60
supine     15:75    -5:30    level     -8:8     -10:30
raised     20:110   -5:30    -30:100   -5:20    0:60
sideways   -10:100  -14:0    -100:20   -4:4     0:60
prone      -10:4    0:25     -70:3     -5:20    10:68
crawling   -25:35   -5:20    -100:-86  -10:10   25:68
plank      -85:-10  -5:20    -85:-15   -8:8     -50:0
back_bend  -30:12   -3:20    -45:0     -8:8     -15:15
bridge     -20:30   -3:20    -115:-70  -10:10   -10:20
crab       85:125   -3:20    -10:35    -10:10   -10:20
upturned   -35:100  -5:45    -60:100   -10:45   0:65
hanging    -25:110  -5:20    -100:90   -10:10   0:60
"""

# Places of a wrist: offset from a joint of its side in lengths of the arm (forward, outwards, up), to where the
# elbow points and, if not along the forearm, the hand. The axes are the trunk's, or do not lean with it.
PLACES = """
name      joint     forward     outwards    up          elbow        hand      axes
own       shoulder  0           0           0           0,0,0        -         trunk
hip       hip       -0.1:0.15   0.15:0.3    0.15:0.4    -0.5,1,0     -         trunk
head      head      -0.3:0.2    0.2:0.35    -0.2:0.2    0.4,1,0.2    -         trunk
ear       head      0:0.2       0.22:0.35   -0.35:-0.1  0.5,0.5,-1   -         trunk
chin      head      0.25:0.45   -0.05:0.25  -0.45:-0.2  0.4,0.5,-1   -         trunk
chest     shoulder  0.35:0.5    -0.8:-0.4   -0.75:-0.4  0,0.9,-1     -         trunk
ahead     shoulder  0.5:1       -0.4:0.4    -0.6:0.2    0,0.7,-1     -         trunk
up        shoulder  -0.2:0.3    -0.2:0.5    0.75:1.05   0.5,1,0      -         trunk
beside    shoulder  -0.05:0.15  0.05:0.35   -1:-0.8     -0.4,1,0     -         trunk
pillow    shoulder  -0.05:0.15  -0.2:0.5    0.2:0.9     0,1,-0.2     -         trunk
cuddle    shoulder  0.3:0.9     -0.5:0      -0.4:0.5    0.2,0,-1     -         trunk
lap       hip       0.3:0.6     -0.35:0     0.2:0.4     -0.4,1,-0.2  -         level
knee      knee      -0.25:0.2   -0.3:0.1    0.12:0.25   -0.3,1,-0.1  -         level
shin      knee      0.1:0.25    -0.35:0     -0.5:-0.1   0,1,-0.1     -         level
down      shoulder  -0.1:0.3    -0.2:0.2    -1.1:-0.9   -0.5,1,0     -         level
floor     shoulder  -0.3:0.4    -0.1:0.3    -1:-0.85    -0.5,1,0.2   1,0,0     level
desk      shoulder  0.35:0.85   -0.5:0.25   -0.75:-0.3  0.2,0.8,-1   -         level
armrest   hip       0.15:0.6    0.2:0.45    0.2:0.45    -0.6,0.7,0   -         level
behind    hip       -0.9:-0.3   0:0.5       -0.2:-0.1   -1,0.5,0     -1,0.5,0  level
overhead  shoulder  -1:-0.8     -0.1:0.3    0:0.4       0.2,0.6,1    0,0,-1    level
"""

# kind: what `without` names. trunk: a of the trunk; spine: by how much the upper trunk leans more. pitch: by how
# much the whole body leans forward: -90 on the back, 90 on the front, 180 upside down; roll: the same to a side.
# rests_on: nothing is lower, and the line between the two is level; with `-` the hips are level, and feet are
# anywhere. arms: places of the hands, equally likely.
POSTURES = """
kind       share  trunk    spine    pitch     roll    legs                rests_on        arms
bend       0.02   35:110   -5:20    0         0       bent_over           ankle           own,down,floor
bend       0.02   0:70     -5:20    0         0       crouching           ankle           own,knee,ahead
bend       0.004  15:65    -5:20    0         0       bent_over           ankle           desk
chair      0.02   -30:55   -5:20    0         0       chair               ankle           SEATED
chair      0.01   -30:40   -5:20    0         0       steady,crossed      ankle           SEATED
chair      0.006  -30:40   -5:20    0         0       steady,figure4      ankle           SEATED
chair      0.008  10:60    -5:25    0         0       chair               ankle           desk,desk,chin
chair      0.005  -35:30   -5:20    0         0       tailor,cross        hip             SEATED
recline    0.012  -50:0    0:30     0         0       over,under          -               RECLINED
recline    0.01   -50:0    0:30     0         0       forward             -               RECLINED
recline    0.01   -55:5    0:30     0         0       propped             -               RECLINED
recline    0.008  -75:-30  0:35     0         0       chair               -               RECLINED
recline    0.004  -60:-20  0:30     0         0       steady,crossed      -               RECLINED
floor      0.006  -35:30   -5:25    0         0       stretched           hip,ankle       FLOOR
floor      0.006  -35:35   -5:25    0         0       knees_up            hip,ankle       FLOOR,shin,shin
floor      0.003  -30:30   -5:25    0         0       stretched,knees_up  hip,ankle       FLOOR
floor      0.009  -15:40   -5:25    0         0       tailor,cross        hip,ankle       FLOOR
floor      0.004  -15:30   -5:20    0         0       cross,side_far      hip,ankle       FLOOR
kneel      0.015  -10:35   -5:20    0         0       kneeling            knee,ankle      own,lap,ahead
kneel      0.01   -10:45   -5:20    0         0       kneeling,foot_flat  knee            own,knee,ahead
kneel      0.015  -10:50   -5:20    0         0       heels               knee,ankle      own,lap,chest
lie        0.0075 -8:8     -5:15    -95:-85   0       straight            shoulder,ankle  LYING
lie        0.005  -8:8     -5:20    -95:-85   0       supine              shoulder,ankle  LYING
lie        0.0025 -8:8     -5:30    -95:-85   0       raised              shoulder,hip    LYING
lie        0.0075 -10:20   -10:25   0         75:105  sideways            shoulder,hip    cuddle
lie        0.005  -5:8     -30:5    85:95     0       prone               hip,knee        beside,pillow
fours      0.015  65:105   -15:15   0         0       crawling            wrist,knee      floor
fours      0.01   70:135   -15:10   0         0       plank               wrist,ankle     floor
bridge     0.005  -60:-10  -45:0    0         0       back_bend           ankle           own,hip,up
bridge     0.003  -25:15   -65:-15  -95:-85   0       bridge              wrist,ankle     overhead
bridge     0.002  -10:10   10:30    -120:-95  0       bridge              shoulder,ankle  beside
bridge     0.0025 -65:-30  -15:15   0         0       crab                wrist,ankle     floor
handstand  0.004  -15:15   -25:10   160:200   0       upturned            wrist           up
hang       0.005  -15:15   -15:10   -10:10    0       hanging             -               up
"""
_ARMS = {
    'SEATED': 'own,knee,knee,lap,lap,chest,ahead,chin,ear,head,beside',
    'RECLINED': 'own,lap,lap,chest,chest,armrest,armrest,chin,head,beside,ahead',
    'FLOOR': 'own,behind,lap,knee,knee,chest',
    'LYING': 'beside,beside,pillow,chest,up,ahead',
}

SYMMETRIC_SHARE = 0.5  # share of the examples with both legs, or both hands, in the same position
SIDE_STD_RAD = 0.08  # rad, standard deviation of each angle by which the two sides differ even then
SWAY_STD_RAD = 0.12  # rad, standard deviation of each angle by which the upper trunk bends aside and twists
MOVING_SHARE = 0.5  # share of the examples that move into or out of the posture
RATE_STD_RAD_S = 0.5  # rad/s, standard deviation of the rate of each angle in these
HAND_SPEED_STD = 0.5  # lengths of the arm a second, standard deviation of each component of the hands' speed
ELBOW_STD = 0.3  # 1, standard deviation of each component of the direction to which an elbow points
HAND_BEND_STD = 0.25  # 1, the same of a hand
LEVEL_STD_RAD = 0.14  # rad, standard deviation by which a shank of `level` is not level
MAX_REACH = 0.995  # of the length of an arm; elbows are never quite straight
MAX_LEVELLING_RAD = 0.8  # rad; postures that have to be tilted by more are none
MAX_BELOW_M = 0.08  # m, by which a joint may be below those that a body rests on; hips are higher than ankles
TRUNK_DEPTH_M, TRUNK_WIDTH_M = 0.075, 0.13  # m, half axes of the inner of the trunk, in which no limb may be
MIN_LEG_GAP_M = 0.05  # m, least distance between the middles of two legs
_SIGNS = np.array([1, -1], np.float32)  # of y outwards, left and right


def joint_indices(*names: str) -> list[int]:
    """Return the indices of joints in `skeleton.BODY26`."""
    return [BODY26.index(n) for n in names]


def limb_indices(name: str) -> list[int]:
    """Return the indices of the joints of a limb of `LIMBS`, or of both `arms` or both `legs`."""
    if name in ('legs', 'arms'):
        return limb_indices('l' + name[:-1]) + limb_indices('r' + name[:-1])
    return joint_indices(*LIMBS[name])


def _sides(joint: str) -> list[int]:
    return joint_indices(*([joint, joint] if joint in BODY26.joints else ['l' + joint, 'r' + joint]))


def _read_ranges(*columns: list[str]) -> Array:
    """Return the ranges (rows, columns, 2) of texts such as `-5:25` and `0`; NaN for `level`."""
    pairs = [[c.replace('level', 'nan').split(':') for c in column] for column in columns]
    return np.array([[(float(p[0]), float(p[-1])) for p in column] for column in pairs], np.float32).swapaxes(0, 1)


def _read_vectors(column: list[str]) -> Array:
    return np.array([t.split(',') if t != '-' else [0, 0, 0] for t in column]).astype(np.float32)


_LEG, _PLACE, _POSTURE = (read_table(t) for t in (LEGS, PLACES, POSTURES))
KINDS = tuple(dict.fromkeys(_POSTURE['kind']))
_SHARES = np.array([float(s) for s in _POSTURE['share']])
_COUNT = len(_SHARES)
_BODY_RANGES = np.radians(_read_ranges(*(_POSTURE[c] for c in ('trunk', 'spine', 'pitch', 'roll'))))
_LEG_RANGES = np.radians(_read_ranges(*(_LEG[c] for c in ('thigh', 'out', 'shank', 'out_2', 'toes'))))
# (P, 2) rows of `LEGS` of a leg and of the other one
_LEGS_OF = np.array([[_LEG['name'].index(n) for n in (legs.split(',') * 2)[:2]] for legs in _POSTURE['legs']])
# (P, 2, 2) joints that bodies rest on, twice the same if it is one pair; the hips for `-`
_IS_FREE = np.array([r == '-' for r in _POSTURE['rests_on']])
_PAIRS = [(r.replace('-', 'hip').split(',') * 2)[:2] for r in _POSTURE['rests_on']]
_RESTS_ON = np.array([[_sides(j) for j in pair] for pair in _PAIRS])
_OFFSETS = _read_ranges(*(_PLACE[c] for c in ('forward', 'outwards', 'up')))
_ELBOWS, _FINGERS = _read_vectors(_PLACE['elbow']), _read_vectors(_PLACE['hand'])
_IS_FLAT = np.array([h != '-' for h in _PLACE['hand']])
_ANCHORS = np.array([_sides(j) for j in _PLACE['joint']])
_IS_LEVEL = np.array([a == 'level' for a in _PLACE['axes']])


def _share_places() -> Array:
    """Return the cumulative shares (P, places) of the places in each posture."""
    out = np.zeros((_COUNT, len(_PLACE['name'])), np.float32)
    for row, arms in zip(out, _POSTURE['arms'], strict=True):
        names = ','.join(_ARMS.get(a, a) for a in arms.split(',')).split(',')
        for name in names:
            row[_PLACE['name'].index(name)] += 1 / len(names)
    out = out.cumsum(axis=1)
    out[:, -1] = 1  # despite rounding
    return out


_PLACE_SHARES = _share_places()
_HIPS = joint_indices('lhip', 'rhip')
_UPPER = [*joint_indices('head', 'neck', 'lshoulder', 'rshoulder', *FACE), *limb_indices('arms')]
_SHOULDERS, _ELBOW, _WRIST, _HAND, _KNEE, _ANKLE, _TOE, _HEEL = (
    _sides(j) for j in ('shoulder', 'elbow', 'wrist', 'hand', 'knee', 'ankle', 'toe', 'heel')
)


def take_postures(vectors: Array, random: RandomArrays, without: Collection[str] = ()) -> Array:
    """Take the postures of `POSTURES` in their shares of the examples.

    Args:
        vectors: (N, T, J, 3) m, bone vectors of bodies that face +x.
        random: source of the random numbers.
        without: kinds of postures that are left out.

    Returns:
        (N, T, J, 3) m, bone vectors.
    """
    count = len(vectors)
    shares = np.where(np.isin(_POSTURE['kind'], list(without)), 0, _SHARES)
    number = np.searchsorted(shares.cumsum(), random.rng.random(count), side='right')
    changed = np.flatnonzero(number < _COUNT)
    kinds = number[changed]
    places = (random.uniform(0, 1, count, 2, 1)[changed] > _PLACE_SHARES[kinds][:, None]).sum(axis=-1)
    places = np.where(random.chance(count, SYMMETRIC_SHARE, axes=1)[changed], places[:, :1], places)
    is_moving = random.chance(len(kinds), MOVING_SHARE, axes=3)
    body = _draw_angles(_BODY_RANGES[kinds][:, None], random, is_moving)[:, 0]
    body[:, 3] *= random.choose(len(kinds), 0.5, 1, -1, axes=1)
    posed = _place_hands(_bend(vectors[changed], kinds, body, is_moving, random), places, random)
    laid, levelling = _lay_down(posed, kinds, body)
    joints = add_bones(laid[:, 0])
    is_good = _check_limbs(joints) & _check_ground(joints, kinds) & (levelling < MAX_LEVELLING_RAD)
    out = vectors.copy()
    out[changed[is_good]] = laid[is_good]
    return out


def _draw_angles(ranges: Array, random: RandomArrays, is_moving: Bools) -> Array:
    """Draw angles (N, S, A, T) of S sides from ranges (N, S, A, 2) in rad; those of the sides are often alike."""
    count, sides, angles, _ = ranges.shape
    share = random.uniform(0, 1, count, sides, angles)
    is_symmetric = random.chance(count, SYMMETRIC_SHARE, axes=2)
    share = np.where(is_symmetric, share[:, :1], share)
    newest = ranges[..., 0] + share * np.ptp(ranges, axis=-1) + SIDE_STD_RAD * random.normal(*share.shape)
    rate = np.float32(RATE_STD_RAD_S) * random.normal(*share.shape, 1) * is_moving
    return np.asarray(newest[..., None] - rate * AGO)


def _bend(vectors: Array, kinds: Integers, body: Array, is_moving: Bools, random: RandomArrays) -> Array:
    """Bend the trunk, upright before, by angles (N, 4, T) of the body, and point the legs in their directions."""
    count = len(vectors)
    out = rotate_points(vectors, np.swapaxes(find_trunks(add_bones(vectors[:, :1])), -1, -2))
    lean, spine, pitch, _ = np.moveaxis(body, 1, 0)
    sway = rotations_from_vectors(SWAY_STD_RAD * random.normal(count, 3) * np.array([1, 0, 1], np.float32))
    out[:, :, _UPPER] = rotate_points(out[:, :, _UPPER], axis_rotations(1, lean + spine) @ sway[:, None])
    out[:, :, _HIPS] = rotate_points(out[:, :, _HIPS], axis_rotations(1, lean))
    ranges = _LEG_RANGES[_LEGS_OF[kinds]]
    ranges = np.where(random.chance(count, 0.5, axes=3), ranges[:, ::-1], ranges)
    thigh, thigh_out, shank, shank_out, toes = np.moveaxis(_draw_angles(ranges, random, is_moving), 2, 0)
    level = np.pi + 2 * pitch[:, None] - thigh + LEVEL_STD_RAD * random.normal(count, 2, 1)
    shank = np.minimum(np.where(np.isnan(shank), level, shank), thigh)  # knees bend one way only

    def point(a: Array, d: Array) -> Array:
        return np.stack([np.cos(d) * np.sin(a), _SIGNS[:, None] * np.sin(d), -np.cos(d) * np.cos(a)], axis=-1)

    upper, lower = point(thigh, thigh_out), point(shank, shank_out)
    # the axis of the knee, which is that of the body where the leg is straight
    hinge = np.cross(lower, upper) + np.array([0, -0.15, 0], np.float32)
    ahead = normalise(np.cross(hinge, lower))
    c, s = np.cos(toes)[..., None], np.sin(toes)[..., None]
    sole, down = c * ahead + s * lower, c * lower - s * ahead
    toe, heel = normalise(sole + 0.36 * down), normalise(down - 0.64 * sole)
    for joints, direction in ((_KNEE, upper), (_ANKLE, lower), (_TOE, toe), (_HEEL, heel)):
        length = np.linalg.norm(vectors[:, :, joints], axis=-1, keepdims=True)
        out[:, :, joints] = length * np.swapaxes(direction, 1, 2)
    return out


def _place_hands(vectors: Array, places: Integers, random: RandomArrays) -> Array:
    """Hold the hands at places (N, 2), with the elbows where they point."""
    count = len(vectors)
    joints = add_bones(vectors)
    trunks = find_trunks(joints)[:, None]
    axes = np.where(_IS_LEVEL[places][..., None, None, None], np.eye(3, dtype=np.float32), trunks)
    outwards = np.stack([np.ones(2, np.float32), _SIGNS, np.ones(2, np.float32)], axis=-1)  # (2, 3)

    def turn(local: Array) -> Array:
        return np.asarray((axes @ (local * outwards[:, None])[..., None])[..., 0])

    lengths = np.linalg.norm(vectors[:, :, [_ELBOW, _WRIST, _HAND]], axis=-1).transpose(2, 0, 3, 1)[..., None]
    upper, lower, _ = lengths
    ranges = _OFFSETS[places]
    offset = ranges[..., 0] + random.uniform(0, 1, count, 2, 3) * np.ptp(ranges, axis=-1)
    speed = random.choose(count, MOVING_SHARE, HAND_SPEED_STD, 0, axes=3) * random.normal(count, 2, 1, 3)
    offset = offset[:, :, None] - speed * AGO[:, None]
    anchors = joints[np.arange(count)[:, None], :, _ANCHORS[places][:, [0, 1], [0, 1]]]
    to_wrist = anchors + turn(offset) * (upper + lower) - np.swapaxes(joints[:, :, _SHOULDERS], 1, 2)
    reach = np.linalg.norm(to_wrist, axis=-1, keepdims=True)
    along = to_wrist / np.maximum(reach, 1e-6)
    reach = np.clip(reach, np.abs(upper - lower) / MAX_REACH + 1e-3, (upper + lower) * MAX_REACH)
    points_to = turn(normalise(_ELBOWS[places])[:, :, None] + ELBOW_STD * random.normal(count, 2, 1, 3))
    aside = normalise(points_to - (points_to * along).sum(axis=-1, keepdims=True) * along)
    share = (upper**2 - lower**2 + reach**2) / (2 * reach)
    elbow = share * along + np.sqrt(np.maximum(upper**2 - share**2, 0)) * aside
    forearm = reach * along - elbow
    bend = HAND_BEND_STD * random.normal(count, 2, 1, 3)
    is_flat = _IS_FLAT[places][..., None, None]
    hand = normalise(np.where(is_flat, turn(_FINGERS[places][:, :, None]), normalise(forearm)) + bend)
    out = vectors.copy()
    is_placed = (places > 0)[:, None, :, None]
    for own, bones in ((_ELBOW, elbow), (_WRIST, forearm), (_HAND, hand * lengths[2])):
        out[:, :, own] = np.where(is_placed, np.swapaxes(bones, 1, 2), out[:, :, own])
    return out


def _lay_down(vectors: Array, kinds: Integers, body: Array) -> tuple[Array, Array]:
    """Turn bodies as a whole, and then so that what they rest on is level; return the angles (N,) of that, too."""
    _, _, pitch, roll = np.moveaxis(body, 1, 0)
    out = rotate_points(vectors, axis_rotations(1, pitch[:, :1]) @ axis_rotations(0, roll[:, :1]))
    rests_on = add_bones(out[:, 0])[np.arange(len(out))[:, None, None], _RESTS_ON[kinds]].mean(axis=2)
    line = rests_on[:, 0] - rests_on[:, 1]
    flat = line * np.array([1, 1, 0], np.float32)
    angle = np.arctan2(np.abs(line[:, 2]), np.linalg.norm(flat, axis=-1))
    rotation = rotations_from_vectors(angle[:, None] * normalise(np.cross(line, flat)))
    return rotate_points(out, rotation[:, None]), angle


def _check_limbs(joints: Array) -> Bools:
    """Return (N,) whether in poses (N, J, 3) no arm or leg is inside the trunk, and no leg inside the other."""
    trunks = find_trunks(joints[:, None])[:, 0]
    middle = joints[:, _HIPS].mean(axis=1)
    length = np.linalg.norm(joints[:, _SHOULDERS].mean(axis=1) - middle, axis=-1)[:, None]
    elbow, wrist, knee, ankle = (joints[:, j] for j in (_ELBOW, _WRIST, _KNEE, _ANKLE))
    outer = np.concatenate([elbow, (elbow + wrist) / 2, wrist, knee, (knee + ankle) / 2, ankle], axis=1)
    x, y, z = np.moveaxis((outer - middle[:, None]) @ trunks, -1, 0)
    is_inside = ((x / TRUNK_DEPTH_M) ** 2 + (y / TRUNK_WIDTH_M) ** 2 < 1) & (z > 0) & (z < length)
    share = np.linspace(0.1, 1, 7, dtype=np.float32)[:, None]
    hip = joints[:, _HIPS]
    segments = ((a[:, :, None], b[:, :, None]) for a, b in ((hip, knee), (knee, ankle)))
    left, right = np.moveaxis(np.concatenate([a + share * (b - a) for a, b in segments], axis=2), 1, 0)
    gap = np.linalg.norm(left[:, :, None] - right[:, None], axis=-1).min(axis=(1, 2))
    return np.asarray(~is_inside.any(axis=1) & (gap > MIN_LEG_GAP_M))


def _check_ground(joints: Array, kinds: Integers) -> Bools:
    """Return (N,) whether no joint is lower than those that a body rests on."""
    rests_on = joints[np.arange(len(joints))[:, None, None], _RESTS_ON[kinds], 2].min(axis=(1, 2))
    return np.asarray(_IS_FREE[kinds] | (joints[:, :CORE_COUNT, 2].min(axis=1) > rests_on - MAX_BELOW_M))
