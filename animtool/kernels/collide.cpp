// Collisions of many particles in one step.
#include "collide.h"

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "kernels.h"
#include "springs_contacts.h"

namespace animtool {

namespace {

using collide::Collider;
using collide::Vec;
using collide::load;
using collide::store;

constexpr std::size_t SIZES = 7, MATERIALS = 4, POSE = 7;

// Colliders as the core has them, of arrays with one row each.
std::vector<Collider> colliders_of(const ColliderArrays& in) {
  const auto& [kinds, sizes, materials, poses, points, triangles, corner_normals,
               edge_normals, bounds, nodes] = in;
  const std::size_t count = kinds.shape(0);
  if (kinds.shape(1) != 3 || sizes.shape(0) != count || sizes.shape(1) != SIZES ||
      materials.shape(0) != count || materials.shape(1) != MATERIALS ||
      poses.shape(0) != count || poses.shape(1) != 2 || poses.shape(2) != POSE)
    throw std::invalid_argument(
        "kinds are (C, 3), sizes (C, 7), materials (C, 4) and poses (C, 2, 7)");
  if (bounds.shape(0) != nodes.shape(0) || points.shape(0) != corner_normals.shape(0) ||
      triangles.shape(0) != edge_normals.shape(0))
    throw std::invalid_argument("arrays of meshes fit each other");
  const collide::Mesh mesh{points.data(),       triangles.data(), corner_normals.data(),
                           edge_normals.data(), bounds.data(),    nodes.data()};
  std::vector<Collider> made(count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::int64_t* kind = kinds.data() + 3 * i;
    Collider& c = made[i];
    if (kind[0] < 0 || kind[0] > 4 || kind[2] < 0 ||
        (kind[0] == 4 && kind[2] >= static_cast<std::int64_t>(nodes.shape(0))))
      throw std::invalid_argument("kinds are 0 to 4, a mesh has a node");
    c.shape = static_cast<collide::Shape>(kind[0]);
    c.container = kind[1] != 0;
    c.root = static_cast<std::int32_t>(kind[2]);
    c.mesh = mesh;
    std::copy_n(sizes.data() + SIZES * i, SIZES, c.size);
    const double* material = materials.data() + MATERIALS * i;
    c.restitution = material[0], c.friction = material[1];
    c.margin = material[2], c.depenetration = material[3];
    const double* pose = poses.data() + 2 * POSE * i;
    c.motion = collide::Motion(pose, pose + POSE);
  }
  return made;
}

}  // namespace

Collided collide_particles(ColliderArrays colliders, In<double, 3> before,
                           In<double, 3> after, In<double, 1> radii,
                           In<double, 1> begins, double step) {
  const std::size_t count = before.shape(1);
  if (before.shape(0) != 2 || before.shape(2) != 3 || after.shape(0) != 2 ||
      after.shape(1) != count || after.shape(2) != 3 || radii.shape(0) != count ||
      begins.shape(0) != count)
    throw std::invalid_argument("states are (2, N, 3), radii and begins (N,)");
  const std::vector<Collider> made = colliders_of(colliders);
  Buffer<double> state(6 * count), normals(3 * count);
  Buffer<std::int64_t> touches(2 * count);
  {
    nb::gil_scoped_release release;
    const double *from = before.data(), *to = after.data();
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t x = 3 * i, v = 3 * (count + i);
      const collide::Particle start{load(from + x), load(from + v)};
      collide::Particle end{load(to + x), load(to + v)};
      collide::Settling settling(made.data(), made.size(), step, radii.data()[i],
                                 begins.data()[i]);
      const collide::Contact contact = settling.settle(start, end);
      store(end.position, state.get() + x);
      store(end.velocity, state.get() + v);
      store(contact.normal, normals.get() + x);
      touches.get()[2 * i] = contact.collider;
      touches.get()[2 * i + 1] = static_cast<std::int64_t>(contact.touch);
    }
  }
  const std::size_t states[3] = {2, count, 3}, rows[2] = {count, 3}, pairs[2] = {count, 2};
  return {state.release(states), touches.release(pairs), normals.release(rows)};
}

ColliderSamples sample_colliders(ColliderArrays colliders, In<double, 2> points,
                                 double share, double step) {
  const std::size_t count = points.shape(0);
  if (points.shape(1) != 3) throw std::invalid_argument("points are (N, 3)");
  const std::vector<Collider> made = colliders_of(colliders);
  const std::size_t rows = made.size() * count;
  Buffer<double> distances(rows), normals(3 * rows), velocities(3 * rows);
  {
    nb::gil_scoped_release release;
    const double rate = step > 0 ? 1 / step : 0.0;
    for (std::size_t c = 0, row = 0; c < made.size(); ++c) {
      const collide::Pose pose = made[c].motion.at(share);
      for (std::size_t i = 0; i < count; ++i, ++row) {
        const Vec point = load(points.data() + 3 * i);
        const auto found = collide::sample(made[c], pose, point, 0, collide::FAR);
        distances.get()[row] = found.distance;
        store(found.normal, normals.get() + 3 * row);
        store(made[c].motion.displacement(point, pose) * rate, velocities.get() + 3 * row);
      }
    }
  }
  const std::size_t flat[2] = {made.size(), count}, deep[3] = {made.size(), count, 3};
  return {distances.release(flat), normals.release(deep), velocities.release(deep)};
}

std::vector<Collider> read_colliders(const ColliderArrays& arrays) {
  return colliders_of(arrays);
}

}  // namespace animtool
