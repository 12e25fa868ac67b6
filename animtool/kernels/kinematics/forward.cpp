// Forward kinematics over all frames of a motion.
#include <cmath>
#include <limits>
#include <vector>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

// World transforms of one frame: linear parts (J, 3, 3) and origins (J, 3).
struct WorldTransforms {
  double* linear;
  double* origins;
};

// Temporary storage for the world transforms of one frame.
class TemporaryFrame {
 public:
  explicit TemporaryFrame(std::size_t joints) : joints_(joints), values_(12 * joints) {}

  WorldTransforms world() { return {values_.data(), values_.data() + 9 * joints_}; }

 private:
  std::size_t joints_;
  std::vector<double> values_;
};

// R(q) . S(s) with numbers of type R. The type float rounds where UsdSkel does.
template <typename Number, typename T>
inline void scaled_matrix(const T* rotation, const T* scale, double* matrix) {
  const Number x = rotation[0], y = rotation[1], z = rotation[2], w = rotation[3];
  const double products[9] = {y * y + z * z, x * y - z * w, x * z + y * w,
                              x * y + z * w, x * x + z * z, y * z - x * w,
                              x * z - y * w, y * z + x * w, x * x + y * y};
  for (int i = 0; i < 9; ++i) {
    const Number value = static_cast<Number>(i % 4 ? 2 * products[i] : 1 - 2 * products[i]);
    matrix[i] = scale ? value * static_cast<Number>(scale[i % 3]) : value;
  }
}

// Computes world = parent . T(t) . R(q) . S(s) of one joint. It inherits scale in the same way as
// UsdSkel.
template <typename Number, typename T>
inline void add_joint(const WorldTransforms& world, std::int64_t parent, std::size_t joint,
                      const T* translation, const T* rotation, const T* scale) {
  double matrix[9];
  scaled_matrix<Number>(rotation, scale, matrix);
  double* linear = world.linear + 9 * joint;
  double* origin = world.origins + 3 * joint;
  if (parent < 0) {
    for (int i = 0; i < 9; ++i) linear[i] = matrix[i];
    for (int i = 0; i < 3; ++i) origin[i] = translation[i];
    return;
  }
  const double* parent_linear = world.linear + 9 * parent;
  const double* parent_origin = world.origins + 3 * parent;
  for (int i = 0; i < 3; ++i) {
    const double a = parent_linear[3 * i], b = parent_linear[3 * i + 1],
                 c = parent_linear[3 * i + 2];
    for (int k = 0; k < 3; ++k)
      linear[3 * i + k] = a * matrix[k] + b * matrix[3 + k] + c * matrix[6 + k];
    origin[i] = a * translation[0] + b * translation[1] + c * translation[2] + parent_origin[i];
  }
}

template <typename Number, typename T>
void forward_frame(const std::int64_t* parents, std::size_t joints, const T* translations,
                   const T* rotations, const T* scales, const WorldTransforms& world) {
  for (std::size_t j = 0; j < joints; ++j)
    add_joint<Number>(world, parents[j], j, translations + 3 * j, rotations + 4 * j,
                      scales ? scales + 3 * j : nullptr);
}

// One kind of transform of the joints over all frames: constant for some joints, animated for the
// others.
struct Channel {
  const double* rest;
  const double* values;                 // (F, A, K)
  std::vector<std::ptrdiff_t> columns;  // columns of animated joints, -1 for the others
  std::size_t animated_count, width;

  const double* value(std::size_t frame, std::size_t joint) const {
    const std::ptrdiff_t column = columns[joint];
    return column < 0
               ? rest + width * joint
               : values + width * (frame * animated_count + static_cast<std::size_t>(column));
  }
};

Channel read_channel(const char* name, const MotionChannel& arrays, std::size_t frames,
                     std::size_t joints, std::size_t width) {
  const std::size_t animated_count = arrays.animated.shape(0);
  check::shape(name, arrays.rest, {joints, width});
  check::shape(name, arrays.animated, {animated_count});
  check::shape(name, arrays.values, {frames, animated_count, width});
  check::indices(name, arrays.animated, 0, static_cast<std::int64_t>(joints));
  Channel channel{arrays.rest.data(), arrays.values.data(), std::vector<std::ptrdiff_t>(joints, -1),
                  animated_count, width};
  for (std::size_t a = 0; a < animated_count; ++a)
    channel.columns[static_cast<std::size_t>(arrays.animated.data()[a])] =
        static_cast<std::ptrdiff_t>(a);
  return channel;
}

void check_parents(const In<std::int64_t, 1>& parents) {
  check::shape("parents", parents, {check::ANY});
  for (std::size_t j = 0; j < parents.shape(0); ++j)
    check::between("parents", parents.data()[j], -1, static_cast<std::int64_t>(j) - 1);
}

// Argument names of translations, rotations and scales.
struct ArgumentNames {
  const char *translations, *rotations, *scales;
};

constexpr ArgumentNames EXACT_ARGUMENT_NAMES{"translations", "rotations", "scales"};
constexpr ArgumentNames WRITTEN_ARGUMENT_NAMES{"written_translations", "written_rotations",
                                               "written_scales"};

template <typename T>
void check_motion(const ArgumentNames& names, std::size_t frames, std::size_t joints,
                  const In<T, 3>& translations, const In<T, 3>& rotations,
                  const std::optional<In<T, 3>>& scales) {
  check::shape(names.translations, translations, {frames, joints, 3});
  check::shape(names.rotations, rotations, {frames, joints, 4});
  if (scales) check::shape(names.scales, *scales, {frames, joints, 3});
}

}  // namespace

void forward_kinematics(In<std::int64_t, 1> parents, In<double, 3> translations,
                        In<double, 3> rotations, std::optional<In<double, 3>> scales,
                        Filled<double, 3> positions, Filled<double, 4> linear) {
  const std::size_t joints = parents.shape(0), frames = translations.shape(0);
  check_parents(parents);
  check_motion(EXACT_ARGUMENT_NAMES, frames, joints, translations, rotations, scales);
  check::shape("positions", positions, {frames, joints, 3});
  check::shape("linear", linear, {frames, joints, 3, 3});
  for (std::size_t frame = 0; frame < frames; ++frame) {
    const std::size_t first_joint = frame * joints;
    forward_frame<double>(parents.data(), joints, translations.data() + 3 * first_joint,
                          rotations.data() + 4 * first_joint,
                          scales ? scales->data() + 3 * first_joint : nullptr,
                          {linear.data() + 9 * first_joint, positions.data() + 3 * first_joint});
  }
}

void forward_motion(const MotionArrays& arrays) {
  const std::size_t joints = arrays.parents.shape(0);
  const std::size_t frames = arrays.rotations.values.shape(0);
  check_parents(arrays.parents);
  const Channel translations = read_channel("translations", arrays.translations, frames, joints, 3);
  const Channel rotations = read_channel("rotations", arrays.rotations, frames, joints, 4);
  std::optional<Channel> scales;
  if (arrays.scales) scales = read_channel("scales", *arrays.scales, frames, joints, 3);
  check::shape("positions", arrays.positions, {frames, joints, 3});
  check::shape("linear", arrays.linear, {frames, joints, 3, 3});
  for (std::size_t frame = 0; frame < frames; ++frame) {
    const WorldTransforms world{arrays.linear.data() + 9 * frame * joints,
                                arrays.positions.data() + 3 * frame * joints};
    for (std::size_t joint = 0; joint < joints; ++joint)
      add_joint<double>(world, arrays.parents.data()[joint], joint,
                        translations.value(frame, joint), rotations.value(frame, joint),
                        scales ? scales->value(frame, joint) : nullptr);
  }
}

RoundingReport measure_rounding(In<std::int64_t, 1> parents, In<double, 3> translations,
                                In<double, 3> rotations, std::optional<In<double, 3>> scales,
                                In<float, 3> written_translations, In<float, 3> written_rotations,
                                std::optional<In<float, 3>> written_scales) {
  const std::size_t joints = parents.shape(0), frames = translations.shape(0);
  check_parents(parents);
  check_motion(EXACT_ARGUMENT_NAMES, frames, joints, translations, rotations, scales);
  check_motion(WRITTEN_ARGUMENT_NAMES, frames, joints, written_translations, written_rotations,
               written_scales);
  Out<double, 3> extents(frames, 2, 3);
  double max_squared_error = 0;
  std::size_t worst_frame = 0, worst_joint = 0;
  TemporaryFrame exact_frame(joints), written_frame(joints), float_frame(joints);
  const WorldTransforms exact_world = exact_frame.world(), written_world = written_frame.world();
  const WorldTransforms float_world = float_frame.world();
  for (std::size_t frame = 0; frame < frames; ++frame) {
    const std::size_t vector_offset = frame * joints * 3, rotation_offset = frame * joints * 4;
    const float* translations_row = written_translations.data() + vector_offset;
    const float* rotations_row = written_rotations.data() + rotation_offset;
    const float* scales_row = written_scales ? written_scales->data() + vector_offset : nullptr;
    forward_frame<double>(parents.data(), joints, translations.data() + vector_offset,
                          rotations.data() + rotation_offset,
                          scales ? scales->data() + vector_offset : nullptr, exact_world);
    forward_frame<double>(parents.data(), joints, translations_row, rotations_row, scales_row,
                          written_world);
    // The extents must equal those of UsdSkel to the last bit.
    forward_frame<float>(parents.data(), joints, translations_row, rotations_row, scales_row,
                         float_world);
    double* low = extents.get() + frame * 6;
    double* high = low + 3;
    for (int i = 0; i < 3; ++i) {
      low[i] = std::numeric_limits<double>::infinity();
      high[i] = -std::numeric_limits<double>::infinity();
    }
    for (std::size_t joint = 0; joint < joints; ++joint) {
      double squared_error = 0;
      for (int i = 0; i < 3; ++i) {
        const double coordinate = float_world.origins[3 * joint + i];
        if (coordinate < low[i]) low[i] = coordinate;
        if (coordinate > high[i]) high[i] = coordinate;
        const double difference =
            written_world.origins[3 * joint + i] - exact_world.origins[3 * joint + i];
        squared_error += difference * difference;
      }
      if (squared_error > max_squared_error) {
        max_squared_error = squared_error;
        worst_frame = frame;
        worst_joint = joint;
      }
    }
  }
  return {std::move(extents), std::sqrt(max_squared_error), worst_frame, worst_joint};
}

}  // namespace animtool
