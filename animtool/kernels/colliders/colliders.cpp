// Collisions of many particles in one step.
#include "colliders/colliders.h"

#include <algorithm>
#include <vector>

#include "base/checks.h"
#include "colliders/arrays.h"

namespace animtool {

namespace {

using collide::Collider;
using collide::load;
using collide::store;
using collide::Vec;

// Numbers per collider in `sizes`, in `materials` and in each of the poses.
constexpr std::size_t SIZE_COUNT = 7, MATERIAL_COUNT = 4, POSE_COUNT = 7;
// The sides from which a collider is hit; only meshes can be hit from both.
constexpr std::int64_t OUTSIDE = 0, INSIDE_ONLY = 1, BOTH_SIDES = 2;

// Checks trees: each node is the child of one earlier node, so that every descent ends, and the
// depth fits the stack of the traversal.
void check_nodes(const In<std::int32_t, 2>& nodes, std::size_t triangles) {
  const std::int32_t* row = nodes.data();
  const auto count = static_cast<std::int64_t>(nodes.shape(0));
  std::vector<std::uint8_t> depths(nodes.shape(0), 0);
  for (std::int64_t n = 0; n < count; ++n, row += 2) {
    if (row[0] < 0) {
      const std::int64_t first = -1 - static_cast<std::int64_t>(row[0]);
      if (row[1] < 0 || first + row[1] > static_cast<std::int64_t>(triangles))
        check::refuse("nodes", "leaf " + check::text(n) + " has triangles that there are not");
      continue;
    }
    for (int side = 0; side < 2; ++side) {
      const std::int64_t child = row[side];
      if (child <= n || child >= count || depths[child])
        check::refuse("nodes", "node " + check::text(n) + " has no child " + check::text(child));
      depths[child] = static_cast<std::uint8_t>(depths[n] + 1);
      if (depths[child] >= collide::MAX_TREE_DEPTH)
        check::refuse("nodes",
                      "the tree is deeper than " + check::text(collide::MAX_TREE_DEPTH - 1));
    }
  }
}

// Checks the shapes and the contents of collider arrays.
void check_arrays(const ColliderArrays& arrays) {
  const auto& [kinds, sizes, materials, poses, points, triangles, corner_normals, edge_normals,
               bounds, nodes] = arrays;
  const std::size_t count = kinds.shape(0);
  check::shape("kinds", kinds, {check::ANY, 3});
  check::shape("sizes", sizes, {count, SIZE_COUNT});
  check::shape("materials", materials, {count, MATERIAL_COUNT});
  check::shape("poses", poses, {count, 2, POSE_COUNT});
  check::shape("points", points, {check::ANY, 3});
  check::shape("triangles", triangles, {check::ANY, 3});
  check::shape("corner_normals", corner_normals, {points.shape(0), 3});
  check::shape("edge_normals", edge_normals, {triangles.shape(0), 3, 3});
  check::shape("nodes", nodes, {check::ANY, 2});
  check::shape("bounds", bounds, {nodes.shape(0), 6});
  check::finite("sizes", sizes);
  check::finite("materials", materials);
  bool has_mesh = false;
  for (std::size_t i = 0; i < count; ++i) {
    const std::int64_t* kind = kinds.data() + 3 * i;
    check::between("kinds", kind[0], 0, static_cast<std::int64_t>(collide::Shape::MESH));
    check::between("kinds", kind[1], OUTSIDE, BOTH_SIDES);
    if (kind[0] != static_cast<std::int64_t>(collide::Shape::MESH)) continue;
    has_mesh = true;
    check::indices("kinds", kind + 2, 1, 0, static_cast<std::int64_t>(nodes.shape(0)));
  }
  if (!has_mesh) return;
  check::at_most("points", points.shape(0), check::MAX_ROWS);
  check::at_most("triangles", triangles.shape(0), check::MAX_ROWS);
  check::at_most("nodes", nodes.shape(0), check::MAX_ROWS);
  check::indices("triangles", triangles, 0, static_cast<std::int64_t>(points.shape(0)));
  check_nodes(nodes, triangles.shape(0));
}

}  // namespace

// Builds the colliders from arrays with one row each.
std::vector<Collider> read_colliders(const ColliderArrays& arrays) {
  const auto& [kinds, sizes, materials, poses, points, triangles, corner_normals, edge_normals,
               bounds, nodes] = arrays;
  check_arrays(arrays);
  const std::size_t count = kinds.shape(0);
  const collide::Mesh mesh{points.data(),       triangles.data(), corner_normals.data(),
                           edge_normals.data(), bounds.data(),    nodes.data()};
  std::vector<Collider> result(count);
  for (std::size_t i = 0; i < count; ++i) {
    const std::int64_t* kind = kinds.data() + 3 * i;
    Collider& c = result[i];
    c.shape = static_cast<collide::Shape>(kind[0]);
    c.is_container = kind[1] == INSIDE_ONLY;
    c.is_two_sided = kind[1] == BOTH_SIDES && c.shape == collide::Shape::MESH;
    c.mesh_root = c.shape == collide::Shape::MESH ? static_cast<std::int32_t>(kind[2]) : 0;
    c.mesh = mesh;
    std::copy_n(sizes.data() + SIZE_COUNT * i, SIZE_COUNT, c.size);
    const double* material = materials.data() + MATERIAL_COUNT * i;
    c.restitution = material[0], c.friction = material[1];
    c.margin = material[2], c.depenetration = material[3];
    const double* pose = poses.data() + 2 * POSE_COUNT * i;
    c.motion = collide::Motion(pose, pose + POSE_COUNT);
  }
  return result;
}

ParticleCollisions collide_particles(ColliderArrays colliders, In<double, 3> before,
                                     In<double, 3> after, In<double, 1> radii, In<double, 1> begins,
                                     double step) {
  const std::size_t count = before.shape(1);
  check::shape("before", before, {2, check::ANY, 3});
  check::shape("after", after, {2, count, 3});
  check::shape("radii", radii, {count});
  check::shape("begins", begins, {count});
  check::non_negative("step", step);
  const std::vector<Collider> world_colliders = read_colliders(colliders);
  Out<double, 3> state(2, count, 3);
  Out<double, 2> normals(count, 3);
  Out<std::int64_t, 2> touches(count, 2);
  const double *from = before.data(), *to = after.data();
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t x = 3 * i, v = 3 * (count + i);
    const collide::Particle start{load(from + x), load(from + v)};
    collide::Particle end{load(to + x), load(to + v)};
    collide::ParticleContacts contacts(world_colliders.data(), world_colliders.size(), step,
                                       radii.data()[i], begins.data()[i]);
    const collide::Contact contact = contacts.resolve(start, end);
    store(end.position, state.get() + x);
    store(end.velocity, state.get() + v);
    store(contact.normal, normals.get() + x);
    touches.get()[2 * i] = contact.collider;
    touches.get()[2 * i + 1] = static_cast<std::int64_t>(contact.touch);
  }
  return {std::move(state), std::move(touches), std::move(normals)};
}

ColliderSamples sample_colliders(ColliderArrays colliders, In<double, 2> points, double fraction,
                                 double step) {
  const std::size_t count = points.shape(0);
  check::shape("points", points, {check::ANY, 3});
  check::between("fraction", fraction, 0, 1);
  check::non_negative("step", step);
  const std::vector<Collider> world_colliders = read_colliders(colliders);
  Out<double, 2> distances(world_colliders.size(), count);
  Out<double, 3> normals(world_colliders.size(), count, 3),
      velocities(world_colliders.size(), count, 3);
  const double inverse_step = step > 0 ? 1 / step : 0.0;
  for (std::size_t c = 0, row = 0; c < world_colliders.size(); ++c) {
    const collide::Pose pose = world_colliders[c].motion.pose_at(fraction);
    for (std::size_t i = 0; i < count; ++i, ++row) {
      const Vec point = load(points.data() + 3 * i);
      const auto hit = collide::sample(world_colliders[c], pose, point, 0, collide::INF);
      distances.get()[row] = hit.distance;
      store(hit.normal, normals.get() + 3 * row);
      store(world_colliders[c].motion.displacement(point, pose) * inverse_step,
            velocities.get() + 3 * row);
    }
  }
  return {std::move(distances), std::move(normals), std::move(velocities)};
}

}  // namespace animtool
