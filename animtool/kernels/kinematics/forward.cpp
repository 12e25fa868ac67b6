// Forward kinematics over all frames of a motion.
#include <cmath>
#include <limits>
#include <vector>

#include "base/checks.h"
#include "kinematics/kinematics.h"

namespace animtool {

namespace {

// World transforms of one frame: linear parts (J, 3, 3) and origins (J, 3).
struct World {
  double* linear;
  double* origins;
};

// Storage for one frame that is not kept.
class Scratch {
 public:
  explicit Scratch(std::size_t joints) : joints_(joints), values_(12 * joints) {}

  World world() { return {values_.data(), values_.data() + 9 * joints_}; }

 private:
  std::size_t joints_;
  std::vector<double> values_;
};

// R(q) . S(s) as numbers R: float rounds where UsdSkel does.
template <typename R, typename T>
inline void scaled_rotation(const T* q, const T* s, double* r) {
  const R x = q[0], y = q[1], z = q[2], w = q[3];
  const double sums[9] = {y * y + z * z, x * y - z * w, x * z + y * w, x * y + z * w, x * x + z * z,
                          y * z - x * w, x * z - y * w, y * z + x * w, x * x + y * y};
  for (int i = 0; i < 9; ++i) {
    const R value = static_cast<R>(i % 4 ? 2 * sums[i] : 1 - 2 * sums[i]);
    r[i] = s ? value * static_cast<R>(s[i % 3]) : value;
  }
}

// world = parent . T(t) . R(q) . S(s), with scale inherited as UsdSkel does.
template <typename R, typename T>
inline void step(const World& world, std::int64_t parent, std::size_t joint, const T* t, const T* q,
                 const T* s) {
  double r[9];
  scaled_rotation<R>(q, s, r);
  double* linear = world.linear + 9 * joint;
  double* origin = world.origins + 3 * joint;
  if (parent < 0) {
    for (int i = 0; i < 9; ++i) linear[i] = r[i];
    for (int i = 0; i < 3; ++i) origin[i] = t[i];
    return;
  }
  const double* p = world.linear + 9 * parent;
  const double* o = world.origins + 3 * parent;
  for (int i = 0; i < 3; ++i) {
    const double a = p[3 * i], b = p[3 * i + 1], c = p[3 * i + 2];
    for (int k = 0; k < 3; ++k) linear[3 * i + k] = a * r[k] + b * r[3 + k] + c * r[6 + k];
    origin[i] = a * t[0] + b * t[1] + c * t[2] + o[i];
  }
}

template <typename R, typename T>
void forward_frame(const std::int64_t* parents, std::size_t joints, const T* t, const T* q,
                   const T* s, const World& world) {
  for (std::size_t j = 0; j < joints; ++j)
    step<R>(world, parents[j], j, t + 3 * j, q + 4 * j, s ? s + 3 * j : nullptr);
}

// Transforms of the joints of each frame: those that move, and those that rest.
struct Channel {
  const double* rest;
  const double* values;                 // (F, A, K)
  std::vector<std::ptrdiff_t> columns;  // of those that move, else -1
  std::size_t moving, width;

  const double* at(std::size_t f, std::size_t j) const {
    const std::ptrdiff_t column = columns[j];
    return column < 0 ? rest + width * j
                      : values + width * (f * moving + static_cast<std::size_t>(column));
  }
};

Channel read_channel(const char* name, const MotionChannel& arrays, std::size_t frames,
                     std::size_t joints, std::size_t width) {
  const std::size_t moving = arrays.animated.shape(0);
  check::shape(name, arrays.rest, {joints, width});
  check::shape(name, arrays.animated, {moving});
  check::shape(name, arrays.values, {frames, moving, width});
  check::indices(name, arrays.animated, 0, static_cast<std::int64_t>(joints));
  Channel channel{arrays.rest.data(), arrays.values.data(), std::vector<std::ptrdiff_t>(joints, -1),
                  moving, width};
  for (std::size_t a = 0; a < moving; ++a)
    channel.columns[static_cast<std::size_t>(arrays.animated.data()[a])] =
        static_cast<std::ptrdiff_t>(a);
  return channel;
}

void check_parents(const In<std::int64_t, 1>& parents) {
  check::shape("parents", parents, {check::ANY});
  for (std::size_t j = 0; j < parents.shape(0); ++j)
    check::between("parents", parents.data()[j], -1, static_cast<std::int64_t>(j) - 1);
}

// Names of translations, rotations and scales.
struct Names {
  const char *translations, *rotations, *scales;
};

constexpr Names EXACT{"translations", "rotations", "scales"};
constexpr Names WRITTEN{"written_translations", "written_rotations", "written_scales"};

template <typename T>
void check_motion(const Names& names, std::size_t frames, std::size_t joints,
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
  check_motion(EXACT, frames, joints, translations, rotations, scales);
  check::shape("positions", positions, {frames, joints, 3});
  check::shape("linear", linear, {frames, joints, 3, 3});
  for (std::size_t f = 0; f < frames; ++f) {
    const std::size_t at = f * joints;
    forward_frame<double>(parents.data(), joints, translations.data() + 3 * at,
                          rotations.data() + 4 * at, scales ? scales->data() + 3 * at : nullptr,
                          {linear.data() + 9 * at, positions.data() + 3 * at});
  }
}

void forward_motion(const MotionArrays& arrays) {
  const std::size_t joints = arrays.parents.shape(0);
  const std::size_t frames = arrays.rotations.values.shape(0);
  check_parents(arrays.parents);
  const Channel t = read_channel("translations", arrays.translations, frames, joints, 3);
  const Channel q = read_channel("rotations", arrays.rotations, frames, joints, 4);
  std::optional<Channel> s;
  if (arrays.scales) s = read_channel("scales", *arrays.scales, frames, joints, 3);
  check::shape("positions", arrays.positions, {frames, joints, 3});
  check::shape("linear", arrays.linear, {frames, joints, 3, 3});
  for (std::size_t f = 0; f < frames; ++f) {
    const World world{arrays.linear.data() + 9 * f * joints,
                      arrays.positions.data() + 3 * f * joints};
    for (std::size_t j = 0; j < joints; ++j)
      step<double>(world, arrays.parents.data()[j], j, t.at(f, j), q.at(f, j),
                   s ? s->at(f, j) : nullptr);
  }
}

RoundingReport measure_rounding(In<std::int64_t, 1> parents, In<double, 3> translations,
                                In<double, 3> rotations, std::optional<In<double, 3>> scales,
                                In<float, 3> written_translations, In<float, 3> written_rotations,
                                std::optional<In<float, 3>> written_scales) {
  const std::size_t joints = parents.shape(0), frames = translations.shape(0);
  check_parents(parents);
  check_motion(EXACT, frames, joints, translations, rotations, scales);
  check_motion(WRITTEN, frames, joints, written_translations, written_rotations, written_scales);
  Out<double, 3> extents(frames, 2, 3);
  double largest = 0;
  std::size_t at_frame = 0, at_joint = 0;
  Scratch exact_frame(joints), written_frame(joints), played_frame(joints);
  const World exact = exact_frame.world(), written = written_frame.world();
  const World played = played_frame.world();
  for (std::size_t f = 0; f < frames; ++f) {
    const std::size_t v = f * joints * 3, q = f * joints * 4;
    const float* t = written_translations.data() + v;
    const float* r = written_rotations.data() + q;
    const float* s = written_scales ? written_scales->data() + v : nullptr;
    forward_frame<double>(parents.data(), joints, translations.data() + v, rotations.data() + q,
                          scales ? scales->data() + v : nullptr, exact);
    forward_frame<double>(parents.data(), joints, t, r, s, written);
    // Extents are compared with UsdSkel's to the last bit.
    forward_frame<float>(parents.data(), joints, t, r, s, played);
    double* low = extents.get() + f * 6;
    double* high = low + 3;
    for (int i = 0; i < 3; ++i) {
      low[i] = std::numeric_limits<double>::infinity();
      high[i] = -std::numeric_limits<double>::infinity();
    }
    for (std::size_t j = 0; j < joints; ++j) {
      double squared = 0;
      for (int i = 0; i < 3; ++i) {
        const double p = played.origins[3 * j + i];
        if (p < low[i]) low[i] = p;
        if (p > high[i]) high[i] = p;
        const double d = written.origins[3 * j + i] - exact.origins[3 * j + i];
        squared += d * d;
      }
      if (squared > largest) {
        largest = squared;
        at_frame = f;
        at_joint = j;
      }
    }
  }
  return {std::move(extents), std::sqrt(largest), at_frame, at_joint};
}

}  // namespace animtool
