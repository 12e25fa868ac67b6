// Soft extension and stretching of limbs.
#include "ik/extension.h"

#include <algorithm>
#include <cmath>

#include "base/checks.h"
#include "ik/solve.h"

namespace animtool {

namespace ik {

namespace {

constexpr std::size_t LIMB_NUMBERS = 7;

// Distance to which a limb extends towards a target: up to the target if that is within (1 - soft)
// of its length, beyond that asymptotically to its full length (A. Nicholas, Soft IK, 2009: the
// exponential ease).
double soft_distance(double distance, double max_length, double softness) {
  if (softness <= 0) return std::min(distance, max_length);
  const double start = (1 - softness) * max_length, width = softness * max_length;
  const double excess = std::max(distance - start, 0.0);
  return distance > start ? start + width * -std::expm1(-excess / width) : distance;
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

void extend_limbs(const std::vector<Limb>& limbs, std::size_t goal_count, const double* targets,
                  double* reachable, double* scales, bool* is_softened) {
  std::copy(targets, targets + goal_count * TARGET_WIDTH, reachable);
  std::fill(scales, scales + goal_count, 1.0);
  std::fill(is_softened, is_softened + goal_count, false);
  for (const Limb& limb : limbs) {
    const double* target = targets + TARGET_WIDTH * limb.goal;
    double offset[3];
    for (int i = 0; i < 3; ++i) offset[i] = target[i] - limb.origin[i];
    const bool has_target = target[WEIGHTS_OFFSET + component_of<Position>()] > 0;
    const double distance = has_target ? length(offset) : 0;
    double extension = soft_distance(distance, limb.max_length, limb.softness);
    if (limb.max_stretch > 0) {
      const double growth =
          std::clamp((distance - extension) / limb.bone_length, 0.0, limb.max_stretch);
      scales[limb.goal] += growth;
      extension = std::min(extension + growth * limb.bone_length, distance);
    }
    if (!(distance > extension)) continue;
    if (limb.softness > 0)
      is_softened[limb.goal] = distance <= limb.max_length + limb.max_stretch * limb.bone_length;
    else if (limb.max_stretch <= 0)
      continue;
    const double ratio = extension / distance;
    double* reachable_target = reachable + TARGET_WIDTH * limb.goal;
    for (int i = 0; i < 3; ++i) reachable_target[i] = limb.origin[i] + offset[i] * ratio;
  }
}

}  // namespace ik

IkExtension extend_ik_limbs(In<std::int64_t, 1> limbs, In<double, 2> limb_numbers,
                            In<double, 3> targets) {
  using namespace ik;
  const std::size_t batch_size = targets.shape(0), goal_count = targets.shape(1);
  check::shape("targets", targets, {check::ANY, check::ANY, TARGET_WIDTH});
  const std::vector<Limb> limb_list = read_limbs(limbs, limb_numbers, goal_count);
  Out<double, 3> reachable(batch_size, goal_count, TARGET_WIDTH);
  Out<double, 2> scales(batch_size, goal_count);
  Out<bool, 2> is_softened(batch_size, goal_count);
  for (std::size_t b = 0; b < batch_size; ++b)
    extend_limbs(limb_list, goal_count, targets.data() + b * goal_count * TARGET_WIDTH,
                 reachable.get() + b * goal_count * TARGET_WIDTH, scales.get() + b * goal_count,
                 is_softened.get() + b * goal_count);
  return {std::move(reachable), std::move(scales), std::move(is_softened)};
}

}  // namespace animtool
