// Finds poses that interpolation between two other poses reproduces.
#include <algorithm>
#include <cmath>
#include <vector>

#include "base/checks.h"
#include "base/rotations.h"
#include "base/vector.h"
#include "curves/curves.h"

namespace animtool {

namespace {

double squared_length(const Vec& a) { return dot(a, a); }

Vec rotate(const Quaternion& q, const Vec& p) {
  const double x = 2 * (q.y * p.z - q.z * p.y), y = 2 * (q.z * p.x - q.x * p.z),
               z = 2 * (q.x * p.y - q.y * p.x);
  return {p.x + q.w * x + q.y * z - q.z * y, p.y + q.w * y + q.z * x - q.x * z,
          p.z + q.w * z + q.x * y - q.y * x};
}

// Half angle [rad] below which the series of `slerp_weight` is accurate to 1e-6.
constexpr double SMALL_HALF_ANGLE = 0.3;

// sin(a t) / sin(t) for a small t.
double slerp_weight(double a, double t) {
  const double t2 = t * t, b = a * a * t2;
  return a * (1 - b / 6 + b * b / 120) * (1 + t2 / 6 + 7 * t2 * t2 / 360);
}

// A hierarchy of joints, and their rest transforms.
struct Chain {
  std::size_t count, moving_count;
  const std::int64_t *parents, *numbers;  // index of each joint in a pose, -1 for a joint at rest
  const Vec* offsets;
  const Quaternion *before, *rest;

  // Computes the positions and world rotations of all joints in a pose.
  void compute_positions(const Quaternion* pose, Quaternion* world, Vec* positions) const {
    for (std::size_t j = 0; j < count; ++j) {
      const Quaternion rotation = before[j] * (numbers[j] < 0 ? rest[j] : pose[numbers[j]]);
      if (parents[j] < 0) {
        world[j] = rotation, positions[j] = offsets[j];
        continue;
      }
      const std::size_t parent = static_cast<std::size_t>(parents[j]);
      positions[j] = positions[parent] + rotate(world[parent], offsets[j]);
      world[j] = world[parent] * rotation;
    }
  }
};

// Interpolation from one pose to another, at constant speed.
class PoseInterpolation {
 public:
  void compute(const Quaternion* a, const Quaternion* b, std::size_t count) {
    start_rotations_ = a, end_rotations_ = b, count_ = count;
    angles_.resize(count), sines_.resize(count);
    for (std::size_t m = 0; m < count; ++m) {
      const double cosine = a[m].x * b[m].x + a[m].y * b[m].y + a[m].z * b[m].z + a[m].w * b[m].w;
      angles_[m] = std::acos(std::clamp(cosine, -1.0, 1.0));
      sines_[m] = angles_[m] < SMALL_HALF_ANGLE ? 0 : std::sin(angles_[m]);
    }
  }

  void evaluate(double fraction, Quaternion* out) const {
    for (std::size_t m = 0; m < count_; ++m) {
      double start_weight, end_weight;
      if (angles_[m] < SMALL_HALF_ANGLE) {
        start_weight = slerp_weight(1 - fraction, angles_[m]),
        end_weight = slerp_weight(fraction, angles_[m]);
      } else {
        start_weight = std::sin((1 - fraction) * angles_[m]) / sines_[m];
        end_weight = std::sin(fraction * angles_[m]) / sines_[m];
      }
      out[m] = {start_weight * start_rotations_[m].x + end_weight * end_rotations_[m].x,
                start_weight * start_rotations_[m].y + end_weight * end_rotations_[m].y,
                start_weight * start_rotations_[m].z + end_weight * end_rotations_[m].z,
                start_weight * start_rotations_[m].w + end_weight * end_rotations_[m].w};
    }
  }

 private:
  const Quaternion *start_rotations_ = nullptr, *end_rotations_ = nullptr;
  std::size_t count_ = 0;
  std::vector<double> angles_, sines_;
};

}  // namespace

std::tuple<Out<bool, 1>, Out<double, 3>> fitting_spans(
    In<double, 3> rotations, In<std::int64_t, 1> parents, In<std::int64_t, 1> numbers,
    In<double, 2> offsets, In<double, 2> before, In<double, 2> rest, In<std::int64_t, 1> feet,
    In<bool, 2> stands, In<std::int64_t, 1> begins, std::int64_t wide, double near, double standing,
    double hips) {
  const std::size_t frames = rotations.shape(0), moving = rotations.shape(1),
                    count = parents.shape(0);
  check::at_most("turns", frames * moving, check::MAX_ROWS);
  check::numbers("turns", rotations, {check::ANY, check::ANY, 4});
  check::shape("numbers", numbers, {count});
  check::numbers("places", offsets, {count, 3});
  check::numbers("before", before, {count, 4});
  check::numbers("rest", rest, {count, 4});
  check::shape("feet", feet, {2});
  check::shape("stands", stands, {frames, 2});
  check::indices("numbers", numbers, -1, static_cast<std::int64_t>(moving));
  check::indices("feet", feet, 0, static_cast<std::int64_t>(count));
  for (std::size_t j = 0; j < count; ++j)
    check::between("parents", parents.data()[j], -1, static_cast<std::int64_t>(j) - 1);
  check::between("wide", wide, 2, static_cast<std::int64_t>(std::max<std::size_t>(frames, 3)) - 1);
  check::indices("begins", begins, 0, static_cast<std::int64_t>(frames) - wide);
  const std::size_t spans = begins.shape(0), inside = static_cast<std::size_t>(wide) - 1;
  Out<bool, 1> fits(spans);
  Out<double, 3> root_shifts(spans, inside, 3);
  const Chain chain{count,
                    moving,
                    parents.data(),
                    numbers.data(),
                    reinterpret_cast<const Vec*>(offsets.data()),
                    reinterpret_cast<const Quaternion*>(before.data()),
                    reinterpret_cast<const Quaternion*>(rest.data())};
  const Quaternion* poses = reinterpret_cast<const Quaternion*>(rotations.data());
  std::vector<Quaternion> world(count), pose(moving);
  std::vector<Vec> exact_positions(frames * count), positions(count);
  for (std::size_t f = 0; f < frames; ++f)
    chain.compute_positions(poses + f * moving, world.data(), exact_positions.data() + f * count);
  const std::size_t foot[2] = {static_cast<std::size_t>(feet.data()[0]),
                               static_cast<std::size_t>(feet.data()[1])};
  PoseInterpolation interpolation;
  for (std::size_t s = 0; s < spans; ++s) {
    const std::size_t first = static_cast<std::size_t>(begins.data()[s]);
    interpolation.compute(poses + first * moving, poses + (first + inside + 1) * moving, moving);
    bool fits_span = true;
    // The middle differs most: most spans that do not fit are found there.
    for (std::size_t k = 0; fits_span && k < inside; ++k) {
      const std::size_t middle = inside / 2;
      const std::size_t index = k == 0 ? middle : k <= middle ? k - 1 : k;
      const std::size_t frame = first + 1 + index;
      const double fraction = static_cast<double>(index + 1) / static_cast<double>(inside + 1);
      interpolation.evaluate(fraction, pose.data());
      chain.compute_positions(pose.data(), world.data(), positions.data());
      const Vec* expected = exact_positions.data() + frame * count;
      const bool* is_standing = stands.data() + 2 * frame;
      Vec root_shift{0, 0, 0};
      for (std::size_t side = 0; side < 2; ++side)
        if (is_standing[side])
          root_shift = root_shift + (expected[foot[side]] - positions[foot[side]]);
      if (is_standing[0] && is_standing[1])
        root_shift = {root_shift.x / 2, root_shift.y / 2, root_shift.z / 2};
      double* shift_row = root_shifts.get() + 3 * (s * inside + index);
      shift_row[0] = root_shift.x, shift_row[1] = root_shift.y, shift_row[2] = root_shift.z;
      fits_span = squared_length(root_shift) <= hips * hips;
      for (std::size_t side = 0; fits_span && side < 2; ++side)
        fits_span = !is_standing[side] ||
                    squared_length(expected[foot[side]] - positions[foot[side]] - root_shift) <=
                        standing * standing;
      for (std::size_t j = 0; fits_span && j < count; ++j)
        fits_span = squared_length(expected[j] - positions[j] - root_shift) <= near * near;
    }
    fits.get()[s] = fits_span;
    if (!fits_span) std::fill_n(root_shifts.get() + 3 * s * inside, 3 * inside, 0.0);
  }
  return {std::move(fits), std::move(root_shifts)};
}

}  // namespace animtool
