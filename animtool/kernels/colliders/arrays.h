// Builds colliders from arrays, and collides particles with them.
#pragma once

#include <cstdint>
#include <tuple>

#include "base/arrays.h"

namespace animtool {

// triangles, corner_normals, edge_normals, bounds, nodes
using MeshTree = std::tuple<Out<std::int32_t, 2>, Out<double, 2>, Out<double, 3>, Out<double, 2>,
                            Out<std::int32_t, 2>>;
MeshTree build_mesh_tree(In<double, 2> points, In<std::int32_t, 2> triangles);

// kinds, sizes, materials, poses; and for meshes: points, triangles, corner normals, edge normals,
// bounds, nodes
using ColliderArrays = std::tuple<In<std::int64_t, 2>, In<double, 2>, In<double, 2>, In<double, 3>,
                                  In<double, 2>, In<std::int32_t, 2>, In<double, 2>, In<double, 3>,
                                  In<double, 2>, In<std::int32_t, 2>>;
// state, touches, normals
using ParticleCollisions = std::tuple<Out<double, 3>, Out<std::int64_t, 2>, Out<double, 2>>;
ParticleCollisions collide_particles(ColliderArrays colliders, In<double, 3> before,
                                     In<double, 3> after, In<double, 1> radii, In<double, 1> begins,
                                     double step);

// distances, normals, velocities
using ColliderSamples = std::tuple<Out<double, 2>, Out<double, 3>, Out<double, 3>>;
ColliderSamples sample_colliders(ColliderArrays colliders, In<double, 2> points, double fraction,
                                 double step);

}  // namespace animtool
