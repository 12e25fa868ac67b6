// Poses that interpolation between two others finds.
#include <algorithm>
#include <cmath>
#include <vector>

#include "base/checks.h"
#include "base/rotations.h"
#include "base/vector.h"
#include "curves/curves.h"

namespace animtool {

namespace {

double squared(const Vec& a) { return dot(a, a); }

Vec turned(const Quaternion& q, const Vec& p) {
  const double x = 2 * (q.y * p.z - q.z * p.y), y = 2 * (q.z * p.x - q.x * p.z),
               z = 2 * (q.x * p.y - q.y * p.x);
  return {p.x + q.w * x + q.y * z - q.z * y, p.y + q.w * y + q.z * x - q.x * z,
          p.z + q.w * z + q.x * y - q.y * x};
}

// Half an angle [rad] below which the series of `part` is right to 1e-6.
constexpr double SMALL = 0.3;

// sin(a t) / sin(t) of a small t.
double part(double a, double t) {
  const double t2 = t * t, b = a * a * t2;
  return a * (1 - b / 6 + b * b / 120) * (1 + t2 / 6 + 7 * t2 * t2 / 360);
}

// A chain of joints: which is above each, and how it is there at rest.
struct Chain {
  std::size_t count, moving;
  const std::int64_t *parents, *numbers;  // of each its place in a pose, -1 at rest
  const Vec* offsets;
  const Quaternion *before, *rest;

  void positions_of(const Quaternion* pose, Quaternion* world, Vec* out_points) const {
    for (std::size_t j = 0; j < count; ++j) {
      const Quaternion rotation = before[j] * (numbers[j] < 0 ? rest[j] : pose[numbers[j]]);
      if (parents[j] < 0) {
        world[j] = rotation, out_points[j] = offsets[j];
        continue;
      }
      const std::size_t above = static_cast<std::size_t>(parents[j]);
      out_points[j] = out_points[above] + turned(world[above], offsets[j]);
      world[j] = world[above] * rotation;
    }
  }
};

// Evenly from one rotation to another.
class Between {
 public:
  void set(const Quaternion* a, const Quaternion* b, std::size_t count) {
    a_ = a, b_ = b, count_ = count;
    angles_.resize(count), sines_.resize(count);
    for (std::size_t m = 0; m < count; ++m) {
      const double cosine = a[m].x * b[m].x + a[m].y * b[m].y + a[m].z * b[m].z + a[m].w * b[m].w;
      angles_[m] = std::acos(std::clamp(cosine, -1.0, 1.0));
      sines_[m] = angles_[m] < SMALL ? 0 : std::sin(angles_[m]);
    }
  }

  void at(double fraction, Quaternion* out) const {
    for (std::size_t m = 0; m < count_; ++m) {
      double p, q;
      if (angles_[m] < SMALL) {
        p = part(1 - fraction, angles_[m]), q = part(fraction, angles_[m]);
      } else {
        p = std::sin((1 - fraction) * angles_[m]) / sines_[m];
        q = std::sin(fraction * angles_[m]) / sines_[m];
      }
      out[m] = {p * a_[m].x + q * b_[m].x, p * a_[m].y + q * b_[m].y, p * a_[m].z + q * b_[m].z,
                p * a_[m].w + q * b_[m].w};
    }
  }

 private:
  const Quaternion *a_ = nullptr, *b_ = nullptr;
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
  Out<double, 3> back(spans, inside, 3);
  const Chain chain{count,
                    moving,
                    parents.data(),
                    numbers.data(),
                    reinterpret_cast<const Vec*>(offsets.data()),
                    reinterpret_cast<const Quaternion*>(before.data()),
                    reinterpret_cast<const Quaternion*>(rest.data())};
  const Quaternion* poses = reinterpret_cast<const Quaternion*>(rotations.data());
  std::vector<Quaternion> world(count), pose(moving);
  std::vector<Vec> exact(frames * count), out_points(count);
  for (std::size_t f = 0; f < frames; ++f)
    chain.positions_of(poses + f * moving, world.data(), exact.data() + f * count);
  const std::size_t foot[2] = {static_cast<std::size_t>(feet.data()[0]),
                               static_cast<std::size_t>(feet.data()[1])};
  Between between;
  for (std::size_t s = 0; s < spans; ++s) {
    const std::size_t first = static_cast<std::size_t>(begins.data()[s]);
    between.set(poses + first * moving, poses + (first + inside + 1) * moving, moving);
    bool good = true;
    // The middle is off most: what does not fit is mostly found there.
    for (std::size_t k = 0; good && k < inside; ++k) {
      const std::size_t half = inside / 2;
      const std::size_t at = k == 0 ? half : k <= half ? k - 1 : k;
      const std::size_t frame = first + 1 + at;
      const double fraction = static_cast<double>(at + 1) / static_cast<double>(inside + 1);
      between.at(fraction, pose.data());
      chain.positions_of(pose.data(), world.data(), out_points.data());
      const Vec* expected = exact.data() + frame * count;
      const bool* down = stands.data() + 2 * frame;
      Vec off{0, 0, 0};
      for (std::size_t side = 0; side < 2; ++side)
        if (down[side]) off = off + (expected[foot[side]] - out_points[foot[side]]);
      if (down[0] && down[1]) off = {off.x / 2, off.y / 2, off.z / 2};
      double* kept = back.get() + 3 * (s * inside + at);
      kept[0] = off.x, kept[1] = off.y, kept[2] = off.z;
      good = squared(off) <= hips * hips;
      for (std::size_t side = 0; good && side < 2; ++side)
        good = !down[side] ||
               squared(expected[foot[side]] - out_points[foot[side]] - off) <= standing * standing;
      for (std::size_t j = 0; good && j < count; ++j)
        good = squared(expected[j] - out_points[j] - off) <= near * near;
    }
    fits.get()[s] = good;
    if (!good) std::fill_n(back.get() + 3 * s * inside, 3 * inside, 0.0);
  }
  return {std::move(fits), std::move(back)};
}

}  // namespace animtool
