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
struct JointHierarchy {
  std::size_t count, moving_count;
  const std::int64_t* parents;
  const std::int64_t* pose_indices;  // index of each joint in a pose, -1 for a joint at rest
  const Vec* offsets;
  const Quaternion *pre_rotations, *rest_rotations;

  // Computes the positions and world rotations of all joints in a pose.
  void compute_positions(const Quaternion* pose, Quaternion* world, Vec* positions) const {
    for (std::size_t j = 0; j < count; ++j) {
      const Quaternion rotation =
          pre_rotations[j] * (pose_indices[j] < 0 ? rest_rotations[j] : pose[pose_indices[j]]);
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
    In<double, 3> joint_rotations, In<std::int64_t, 1> parents, In<std::int64_t, 1> pose_indices,
    In<double, 2> positions, In<double, 2> pre_rotations, In<double, 2> rest_rotations,
    In<std::int64_t, 1> feet, In<bool, 2> foot_stands, In<std::int64_t, 1> span_starts,
    std::int64_t span_width, double max_joint_error, double max_foot_error, double max_root_shift) {
  const std::size_t frames = joint_rotations.shape(0), moving_count = joint_rotations.shape(1),
                    count = parents.shape(0);
  check::at_most("joint_rotations", frames * moving_count, check::MAX_ROWS);
  check::numbers("joint_rotations", joint_rotations, {check::ANY, check::ANY, 4});
  check::shape("pose_indices", pose_indices, {count});
  check::numbers("positions", positions, {count, 3});
  check::numbers("pre_rotations", pre_rotations, {count, 4});
  check::numbers("rest_rotations", rest_rotations, {count, 4});
  check::shape("feet", feet, {2});
  check::shape("foot_stands", foot_stands, {frames, 2});
  check::indices("pose_indices", pose_indices, -1, static_cast<std::int64_t>(moving_count));
  check::indices("feet", feet, 0, static_cast<std::int64_t>(count));
  for (std::size_t j = 0; j < count; ++j)
    check::between("parents", parents.data()[j], -1, static_cast<std::int64_t>(j) - 1);
  check::between("span_width", span_width, 2,
                 static_cast<std::int64_t>(std::max<std::size_t>(frames, 3)) - 1);
  check::indices("span_starts", span_starts, 0, static_cast<std::int64_t>(frames) - span_width);
  const std::size_t span_count = span_starts.shape(0),
                    inner_count = static_cast<std::size_t>(span_width) - 1;
  Out<bool, 1> span_fits(span_count);
  Out<double, 3> root_shifts(span_count, inner_count, 3);
  const JointHierarchy hierarchy{count,
                                 moving_count,
                                 parents.data(),
                                 pose_indices.data(),
                                 reinterpret_cast<const Vec*>(positions.data()),
                                 reinterpret_cast<const Quaternion*>(pre_rotations.data()),
                                 reinterpret_cast<const Quaternion*>(rest_rotations.data())};
  const Quaternion* poses = reinterpret_cast<const Quaternion*>(joint_rotations.data());
  std::vector<Quaternion> world(count), pose(moving_count);
  std::vector<Vec> exact_positions(frames * count), pose_positions(count);
  for (std::size_t f = 0; f < frames; ++f)
    hierarchy.compute_positions(poses + f * moving_count, world.data(),
                                exact_positions.data() + f * count);
  const std::size_t foot_joints[2] = {static_cast<std::size_t>(feet.data()[0]),
                                      static_cast<std::size_t>(feet.data()[1])};
  PoseInterpolation interpolation;
  for (std::size_t s = 0; s < span_count; ++s) {
    const std::size_t first = static_cast<std::size_t>(span_starts.data()[s]);
    interpolation.compute(poses + first * moving_count,
                          poses + (first + inner_count + 1) * moving_count, moving_count);
    bool fits_span = true;
    // The middle differs most: most spans that do not fit are found there.
    for (std::size_t k = 0; fits_span && k < inner_count; ++k) {
      const std::size_t middle_index = inner_count / 2;
      const std::size_t index = k == 0 ? middle_index : k <= middle_index ? k - 1 : k;
      const std::size_t frame = first + 1 + index;
      const double fraction = static_cast<double>(index + 1) / static_cast<double>(inner_count + 1);
      interpolation.evaluate(fraction, pose.data());
      hierarchy.compute_positions(pose.data(), world.data(), pose_positions.data());
      const Vec* expected_positions = exact_positions.data() + frame * count;
      const bool* is_standing = foot_stands.data() + 2 * frame;
      Vec root_shift{0, 0, 0};
      for (std::size_t side = 0; side < 2; ++side)
        if (is_standing[side])
          root_shift = root_shift +
                       (expected_positions[foot_joints[side]] - pose_positions[foot_joints[side]]);
      if (is_standing[0] && is_standing[1])
        root_shift = {root_shift.x / 2, root_shift.y / 2, root_shift.z / 2};
      double* shift_row = root_shifts.get() + 3 * (s * inner_count + index);
      shift_row[0] = root_shift.x, shift_row[1] = root_shift.y, shift_row[2] = root_shift.z;
      fits_span = squared_length(root_shift) <= max_root_shift * max_root_shift;
      for (std::size_t side = 0; fits_span && side < 2; ++side)
        fits_span =
            !is_standing[side] || squared_length(expected_positions[foot_joints[side]] -
                                                 pose_positions[foot_joints[side]] - root_shift) <=
                                      max_foot_error * max_foot_error;
      for (std::size_t j = 0; fits_span && j < count; ++j)
        fits_span = squared_length(expected_positions[j] - pose_positions[j] - root_shift) <=
                    max_joint_error * max_joint_error;
    }
    span_fits.get()[s] = fits_span;
    if (!fits_span) std::fill_n(root_shifts.get() + 3 * s * inner_count, 3 * inner_count, 0.0);
  }
  return {std::move(span_fits), std::move(root_shifts)};
}

}  // namespace animtool
