"""Whole skeletons of conventions, with the joints that are none of a body.

A line is a joint, `name: role`; what is indented below it hangs on it. `{s}` stands for
the word of either side. Where joints are follows from their roles.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import cache

import numpy as np

from animtool.retarget.roles import CONTROL, END, TWIST, base_role
from animtool.rig.skeleton import Joint, Rig

# Where joints of a role begin, of the left side [m], and which role they lead to.
PLACES = {
    "root": ((0.0, 0.0, 0.0), ""),
    "hips": ((0.0, 0.95, 0.0), ""),
    "pelvis": ((0.02, 0.92, 0.0), "thigh"),
    "spine": ((0.0, 1.02, -0.01), "neck"),
    "neck": ((0.0, 1.48, 0.0), "head"),
    "head": ((0.0, 1.58, 0.02), ""),
    "jaw": ((0.0, 1.6, 0.04), ""),
    "eye": ((0.03, 1.65, 0.1), ""),
    "clavicle": ((0.03, 1.42, 0.02), "upper_arm"),
    "upper_arm": ((0.17, 1.42, 0.0), "forearm"),
    "forearm": ((0.45, 1.42, -0.01), "hand"),
    "hand": ((0.7, 1.42, 0.0), "index_1"),
    "fingers": ((0.79, 1.42, 0.0), ""),
    "thigh": ((0.09, 0.9, 0.0), "shin"),
    "shin": ((0.09, 0.48, 0.01), "foot"),
    "foot": ((0.09, 0.08, -0.02), "toe"),
    "toe": ((0.09, 0.02, 0.11), ""),
    "thumb_1": ((0.72, 1.41, 0.026), ""),
    "thumb_2": ((0.75, 1.41, 0.062), ""),
    "thumb_3": ((0.77, 1.41, 0.087), ""),
    **{
        f"{digit}_{i}": ((x, 1.42, z if i else z / 2), "")
        for digit, z in {
            "index": 0.026,
            "middle": 0.004,
            "ring": -0.017,
            "pinky": -0.036,
        }.items()
        for i, x in enumerate((0.725, 0.79, 0.83, 0.857))
    },
}


def fingers(indent: str, names: str, digits: str, *, first: int = 1) -> str:
    """Return the lines of a hand's fingers.

    Args:
        indent: Spaces before them.
        names: Of a joint, with ``{d}`` for the digit and ``{i}`` for its number.
        digits: Five words of the convention.
        first: Number of the first joint of all but the thumb.
    """
    lines = []
    roles = ("thumb", "index", "middle", "ring", "pinky")
    for role, digit in zip(roles, digits.split(), strict=True):
        numbers = range(1 if role == "thumb" else first, 4)
        for depth, i in enumerate(numbers):
            name = names.replace("{d}", digit).replace("{i}", str(i))
            lines.append(f"{indent}{' ' * depth}{name}: {role}_{i}")
    return "\n".join(lines)


@cache
def full_rig(text: str, sides: str) -> tuple[Rig, list[str]]:
    """Return the rig of indented lines, and the role of each of its joints."""
    joints: list[Joint] = []
    roles: list[str] = []
    positions: list[np.ndarray] = []
    rows = list(_rows(text, sides.split()))
    totals = Counter(role for _, _, role in rows)
    seen: Counter[str] = Counter()
    for name, parent, role in rows:
        share = seen[role] / totals[role]
        seen[role] += 1
        at = _place(role, share, parent, positions, roles)
        offset = at - positions[parent] if parent >= 0 else at
        joints.append(Joint(name, parent, translation=tuple(map(float, offset))))
        positions.append(at)
        roles.append(role)
    return Rig("full", tuple(joints)), roles


def _rows(text: str, sides: list[str]) -> Iterator[tuple[str, int, str]]:
    """Yield the name, the parent's index and the role of each joint."""
    # By depth: the index of the last joint of either side.
    above: list[tuple[int, int, int]] = []
    count = 0
    for line in filter(str.strip, text.splitlines()):
        depth = len(line) - len(line.lstrip())
        name, _, role = line.strip().rpartition(":")
        above = [entry for entry in above if entry[0] < depth]
        parents = above[-1][1:] if above else (-1, -1)
        sided = "{s}" in name
        for k, word in enumerate(sides if sided else [""]):
            own = role.strip()
            plain = own in {"", TWIST, END, CONTROL}
            full = f"{own}_{'lr'[k]}" if sided and not plain else own
            yield name.replace("{s}", word), parents[k], full
        above.append((depth, count, count + sided))
        count += 1 + sided


def _place(
    role: str, share: float, parent: int, at: list[np.ndarray], roles: list[str]
) -> np.ndarray:
    """Return where a joint is: between its role's place and the next one's."""
    base = base_role(role)
    sign = np.array([-1.0 if role.endswith("_r") else 1.0, 1.0, 1.0])
    if base in PLACES:
        begin, following = PLACES[base]
        end = PLACES[following][0] if following else begin
        # One joint of a chain is at its place, more are on the way to the next.
        return sign * (np.array(begin) + share * (np.subtract(end, begin)))
    if parent < 0 or role == CONTROL:
        return at[parent] if parent >= 0 else np.zeros(3)
    if role == TWIST:
        begin, following = PLACES[base_role(roles[parent])]
        side = np.array([-1.0 if roles[parent].endswith("_r") else 1.0, 1.0, 1.0])
        end = PLACES[following][0] if following else begin
        return at[parent] + 0.4 * side * np.subtract(end, begin)
    if role == END:
        return at[parent] + np.array([0.01, 0.02, 0.02])
    return at[parent] + np.array([0.0, 0.03, -0.05])


_UE5 = """
root: root
 pelvis: hips
  spine_01: spine
   spine_02: spine
    spine_03: spine
     spine_04: spine
      spine_05: spine
       neck_01: neck
        neck_02: neck
         head: head
       clavicle_{s}: clavicle
        upperarm_{s}: upper_arm
         upperarm_twist_01_{s}: twist
         upperarm_twist_02_{s}: twist
         upperarm_corrective_{s}: control
         lowerarm_{s}: forearm
          lowerarm_twist_02_{s}: twist
          lowerarm_twist_01_{s}: twist
          hand_{s}: hand
FINGERS
  thigh_{s}: thigh
   thigh_twist_01_{s}: twist
   calf_{s}: shin
    calf_twist_01_{s}: twist
    foot_{s}: foot
     ball_{s}: toe
 ik_foot_root: control
  ik_foot_{s}: control
 ik_hand_root: control
  ik_hand_gun: control
   ik_hand_{s}: control
 center_of_mass:
""".replace(
    "FINGERS",
    fingers(" " * 11, "{d}_0{i}_{s}", "thumb index middle ring pinky"),
)
_BIPED = """
Bip01: root
 Bip01 Pelvis: hips
  Bip01 Spine: spine
   Bip01 {s} Thigh: thigh
    Bip01 {s} Calf: shin
     Bip01 {s} Foot: foot
      Bip01 {s} Toe0: toe
       Bip01 {s} Toe0Nub: end
   Bip01 Spine1: spine
    Bip01 Spine2: spine
     Bip01 Neck: neck
      Bip01 Head: head
       Bip01 HeadNub: end
      Bip01 {s} Clavicle: clavicle
       Bip01 {s} UpperArm: upper_arm
        Bip01 {s} UpArmTwist: twist
        Bip01 {s} Forearm: forearm
         Bip01 {s} ForeTwist: twist
         Bip01 {s} Hand: hand
          Bip01 {s} Finger0: thumb_1
           Bip01 {s} Finger01: thumb_2
            Bip01 {s} Finger02: thumb_3
             Bip01 {s} Finger0Nub: end
          Bip01 {s} Finger1: index_1
           Bip01 {s} Finger11: index_2
            Bip01 {s} Finger12: index_3
 Bip01 Footsteps:
"""
_CC = """
RL_BoneRoot: root
 CC_Base_Hip: hips
  CC_Base_Pelvis: pelvis
   CC_Base_{s}_Thigh: thigh
    CC_Base_{s}_ThighTwist01: twist
    CC_Base_{s}_Calf: shin
     CC_Base_{s}_KneeShareBone: control
     CC_Base_{s}_CalfTwist01: twist
     CC_Base_{s}_Foot: foot
      CC_Base_{s}_ToeBase: toe
       CC_Base_{s}_BigToe1:
       CC_Base_{s}_IndexToe1:
  CC_Base_Waist: spine
   CC_Base_Spine01: spine
    CC_Base_Spine02: spine
     CC_Base_NeckTwist01: neck
      CC_Base_NeckTwist02: neck
       CC_Base_Head: head
        CC_Base_FacialBone:
         CC_Base_{s}_Eye: eye
     CC_Base_{s}_Clavicle: clavicle
      CC_Base_{s}_Upperarm: upper_arm
       CC_Base_{s}_UpperarmTwist01: twist
       CC_Base_{s}_Forearm: forearm
        CC_Base_{s}_ForearmTwist01: twist
        CC_Base_{s}_Hand: hand
FINGERS
     CC_Base_{s}_Breast:
""".replace(
    "FINGERS",
    fingers(" " * 9, "CC_Base_{s}_{d}{i}", "Thumb Index Mid Ring Pinky"),
)
_RIGIFY = """
root: root
 DEF-spine: hips
  DEF-spine.001: spine
   DEF-spine.002: spine
    DEF-spine.003: spine
     DEF-spine.004: neck
      DEF-spine.005: neck
       DEF-spine.006: head
     DEF-shoulder.{s}: clavicle
      DEF-upper_arm.{s}: upper_arm
       DEF-upper_arm.{s}.001: upper_arm
        DEF-forearm.{s}: forearm
         DEF-forearm.{s}.001: forearm
          DEF-hand.{s}: hand
FINGERS
     DEF-breast.{s}:
  DEF-pelvis.{s}:
  DEF-thigh.{s}: thigh
   DEF-thigh.{s}.001: thigh
    DEF-shin.{s}: shin
     DEF-shin.{s}.001: shin
      DEF-foot.{s}: foot
       DEF-toe.{s}: toe
""".replace(
    "FINGERS",
    fingers(" " * 11, "DEF-{d}.0{i}.{s}", "thumb f_index f_middle f_ring f_pinky"),
)
_DAZ = """
hip: hips
 abdomen: spine
  chest: spine
   neck: neck
    head: head
     {s}eye: eye
   {s}Collar: clavicle
    {s}Shldr: upper_arm
     {s}ForeArm: forearm
      {s}Hand: hand
FINGERS
 {s}Buttock: pelvis
  {s}Thigh: thigh
   {s}Shin: shin
    {s}Foot: foot
     {s}Toe: toe
""".replace("FINGERS", fingers(" " * 7, "{s}{d}{i}", "Thumb Index Mid Ring Pinky"))
_ACCLAIM = """
root: hips
 {s}hipjoint: pelvis
  {s}femur: thigh
   {s}tibia: shin
    {s}foot: foot
     {s}toes: toe
 lowerback: spine
  upperback: spine
   thorax: spine
    lowerneck: neck
     upperneck: neck
      head: head
    {s}clavicle: clavicle
     {s}humerus: upper_arm
      {s}radius: forearm
       {s}wrist: hand
        {s}hand: hand
         {s}fingers: fingers
        {s}thumb: thumb_1
"""
_ROKOKO = """
newton: root
 Hips: hips
  Spine1: spine
   Spine2: spine
    Spine3: spine
     Spine4: spine
      Neck: neck
       Head: head
        HeadVertex: end
      {s}Shoulder: clavicle
       {s}Arm: upper_arm
        {s}ForeArm: forearm
         {s}Hand: hand
          {s}Finger1Metacarpal: thumb_1
           {s}Finger1Proximal: thumb_2
            {s}Finger1Distal: thumb_3
             {s}Finger1Tip: end
          {s}Finger2Metacarpal: index_0
           {s}Finger2Proximal: index_1
            {s}Finger2Medial: index_2
             {s}Finger2Distal: index_3
              {s}Finger2Tip: end
          Props_{s}Arm: control
  {s}Thigh: thigh
   {s}Shin: shin
    {s}Foot: foot
     {s}Toe: toe
      {s}ToeTip: end
"""
_HANIM = """
humanoid_root: root
 sacroiliac: hips
  {s}_hip: thigh
   {s}_knee: shin
    {s}_ankle: foot
     {s}_subtalar: foot
      {s}_midtarsal: foot
       {s}_metatarsal: toe
 vl5: spine
  vl1: spine
   vt12: spine
    vt4: spine
     vc7: neck
      vc4: neck
       skullbase: head
     {s}_sternoclavicular: clavicle
      {s}_acromioclavicular: clavicle
       {s}_shoulder: upper_arm
        {s}_elbow: forearm
         {s}_wrist: hand
FINGERS
""".replace(
    "FINGERS",
    fingers(" " * 10, "{s}_{d}{i}", "thumb index middle ring pinky", first=0),
)
_VROID = """
Root: root
 J_Bip_C_Hips: hips
  J_Bip_C_Spine: spine
   J_Bip_C_Chest: spine
    J_Bip_C_UpperChest: spine
     J_Sec_{s}_Bust1:
     J_Bip_C_Neck: neck
      J_Bip_C_Head: head
       J_Adj_{s}_FaceEye: eye
       J_Sec_Hair1_01:
        J_Sec_Hair2_01:
         J_Sec_Hair3_01:
     J_Bip_{s}_Shoulder: clavicle
      J_Bip_{s}_UpperArm: upper_arm
       J_Bip_{s}_LowerArm: forearm
        J_Bip_{s}_Hand: hand
FINGERS
  J_Bip_{s}_UpperLeg: thigh
   J_Sec_{s}_SkirtFront_01:
    J_Sec_{s}_SkirtFront_02:
   J_Bip_{s}_LowerLeg: shin
    J_Bip_{s}_Foot: foot
     J_Bip_{s}_ToeBase: toe
""".replace(
    "FINGERS",
    fingers(" " * 9, "J_Bip_{s}_{d}{i}", "Thumb Index Middle Ring Little"),
)
_ARKIT = """
root: root
 hips_joint: hips
  spine_1_joint: spine
   spine_2_joint: spine
    spine_3_joint: spine
     spine_7_joint: spine
      neck_1_joint: neck
       neck_4_joint: neck
        head_joint: head
         jaw_joint: jaw
          chin_joint:
         nose_joint:
         {s}_eye_joint: eye
          {s}_eyeUpperLid_joint:
      {s}_shoulder_1_joint: clavicle
       {s}_arm_joint: upper_arm
        {s}_forearm_joint: forearm
         {s}_hand_joint: hand
          {s}_handThumbStart_joint: thumb_1
           {s}_handThumb_1_joint: thumb_2
            {s}_handThumb_2_joint: thumb_3
             {s}_handThumbEnd_joint: end
          {s}_handIndexStart_joint: index_0
           {s}_handIndex_1_joint: index_1
            {s}_handIndex_2_joint: index_2
             {s}_handIndex_3_joint: index_3
              {s}_handIndexEnd_joint: end
  {s}_upLeg_joint: thigh
   {s}_leg_joint: shin
    {s}_foot_joint: foot
     {s}_toes_joint: toe
      {s}_toesEnd_joint: end
"""
# By convention: the lines, and the words of the sides.
FULL_RIGS = {
    "ue5_manny": (_UE5, "l r"),
    "max_biped": (_BIPED, "L R"),
    "reallusion_cc": (_CC, "L R"),
    "rigify_metarig": (_RIGIFY, "L R"),
    "cmu_daz_bvh": (_DAZ, "l r"),
    "acclaim_asf": (_ACCLAIM, "l r"),
    "rokoko_newton": (_ROKOKO, "Left Right"),
    "hanim": (_HANIM, "l r"),
    "vroid": (_VROID, "L R"),
    "arkit_body": (_ARKIT, "left right"),
}
