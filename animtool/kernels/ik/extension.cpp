// Soft extension and stretch of limbs.
#include "ik/extension.h"

#include <algorithm>
#include <cmath>

#include "base/checks.h"
#include "ik/solve.h"

namespace animtool {

namespace ik {

namespace {

constexpr std::size_t LIMB_NUMBERS = 7;

// How far a limb extends towards a target: up to the target as long as that is within
// (1 - soft) reach, then asymptotically to its full reach (A. Nicholas, Soft IK, 2009: the
// exponential ease).
double soft_distance(double distance, double reach, double soft) {
  if (soft <= 0) return std::min(distance, reach);
  const double start = (1 - soft) * reach, width = soft * reach;
  const double beyond = std::max(distance - start, 0.0);
  return distance > start ? start + width * -std::expm1(-beyond / width) : distance;
}

}  // namespace

std::vector<Limb> read_limbs(const In<std::int64_t, 1>& goals, const In<double, 2>& numbers,
                             std::size_t count) {
  check::shape("limbs", goals, {check::ANY});
  check::shape("limb_numbers", numbers, {goals.shape(0), LIMB_NUMBERS});
  std::vector<Limb> limbs;
  for (std::size_t i = 0; i < goals.shape(0); ++i) {
    check::indices("limbs", goals.data() + i, 1, 0, static_cast<std::int64_t>(count));
    const double* row = numbers.data() + LIMB_NUMBERS * i;
    limbs.push_back({static_cast<std::size_t>(goals.data()[i]),
                     {row[0], row[1], row[2]},
                     row[3],
                     row[4],
                     row[5],
                     row[6]});
  }
  return limbs;
}

void extend(const std::vector<Limb>& limbs, std::size_t count, const double* targets,
            double* reachable, double* scales, bool* softened) {
  std::copy(targets, targets + count * TARGET_WIDTH, reachable);
  std::fill(scales, scales + count, 1.0);
  std::fill(softened, softened + count, false);
  for (const Limb& limb : limbs) {
    const double* target = targets + TARGET_WIDTH * limb.goal;
    double towards[3];
    for (int i = 0; i < 3; ++i) towards[i] = target[i] - limb.origin[i];
    const bool asked = target[WEIGHTS + part_of<Position>()] > 0;
    const double distance = asked ? length(towards) : 0;
    double extent = soft_distance(distance, limb.reach, limb.soft);
    if (limb.stretch > 0) {
      const double grown = std::clamp((distance - extent) / limb.bones, 0.0, limb.stretch);
      scales[limb.goal] += grown;
      extent = std::min(extent + grown * limb.bones, distance);
    }
    if (!(distance > extent)) continue;
    if (limb.soft > 0)
      softened[limb.goal] = distance <= limb.reach + limb.stretch * limb.bones;
    else if (limb.stretch <= 0)
      continue;
    const double ratio = extent / distance;
    double* moved = reachable + TARGET_WIDTH * limb.goal;
    for (int i = 0; i < 3; ++i) moved[i] = limb.origin[i] + towards[i] * ratio;
  }
}

}  // namespace ik

IkExtended extend_ik_limbs(In<std::int64_t, 1> limbs, In<double, 2> limb_numbers,
                           In<double, 3> targets) {
  using namespace ik;
  const std::size_t batch = targets.shape(0), goals = targets.shape(1);
  check::shape("targets", targets, {check::ANY, check::ANY, TARGET_WIDTH});
  const std::vector<Limb> read = read_limbs(limbs, limb_numbers, goals);
  Out<double, 3> reachable(batch, goals, TARGET_WIDTH);
  Out<double, 2> scales(batch, goals);
  Out<bool, 2> softened(batch, goals);
  for (std::size_t b = 0; b < batch; ++b)
    extend(read, goals, targets.data() + b * goals * TARGET_WIDTH,
           reachable.get() + b * goals * TARGET_WIDTH, scales.get() + b * goals,
           softened.get() + b * goals);
  return {std::move(reachable), std::move(scales), std::move(softened)};
}

}  // namespace animtool
