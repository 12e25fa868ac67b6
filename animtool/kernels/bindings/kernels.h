// What animtool._kernels offers. Pure functions on arrays: no I/O, no Python
// objects inside the loops, the GIL released while they run.
#pragma once

#include <cstdint>
#include <optional>
#include <tuple>

#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>

#include "base/arrays.h"

namespace animtool {

// values, row_lines, consumed, lines, fault, found, token
using BvhRows = std::tuple<Out<double, 2>, Out<std::int64_t, 1>, std::size_t, std::size_t, int,
                           std::size_t, nb::bytes>;
// extents, error, frame, joint
using RoundingReport = std::tuple<Out<double, 3>, double, std::size_t, std::size_t>;
// frames, ins, outs
using FittedCubics = std::tuple<Out<std::int64_t, 1>, Out<double, 2>, Out<double, 2>>;

// rotations, stretches
using Stretched = std::tuple<Out<double, 3>, Out<double, 4>>;

// rounded, error, frame, vertex
using RoundedPoints = std::tuple<Out<float, 3>, double, std::size_t, std::size_t>;

// coordinates, misses, reports, seconds
using IkSolved = std::tuple<Out<double, 2>, Out<double, 3>, Out<std::int64_t, 2>, Out<double, 1>>;
// coordinates, residuals, Jacobians, curvatures
using IkLinearized = std::tuple<Out<double, 2>, Out<double, 2>, Out<double, 3>, Out<double, 2>>;

// coordinates, misses, rounds, cost before and after
using IkSmoothed = std::tuple<Out<double, 2>, Out<double, 3>, int, double, double>;

// coordinates, misses, searched, taken, rounds, cost before and after
using IkFitted = std::tuple<Out<double, 2>, Out<double, 3>, Out<std::int64_t, 1>,
                            Out<std::int64_t, 2>, int, double, double>;

// triangles, corner_normals, edge_normals, bounds, nodes
using MeshTree = std::tuple<Out<std::int32_t, 2>, Out<double, 2>, Out<double, 3>,
                            Out<double, 2>, Out<std::int32_t, 2>>;
// kinds, sizes, materials, poses, and of meshes: points, triangles, corner normals, edge
// normals, bounds, nodes
using ColliderArrays =
    std::tuple<In<std::int64_t, 2>, In<double, 2>, In<double, 2>, In<double, 3>, In<double, 2>,
               In<std::int32_t, 2>, In<double, 2>, In<double, 3>, In<double, 2>,
               In<std::int32_t, 2>>;
// state, touches, normals
using Collided = std::tuple<Out<double, 3>, Out<std::int64_t, 2>, Out<double, 2>>;
// distances, normals, velocities
using ColliderSamples = std::tuple<Out<double, 2>, Out<double, 3>, Out<double, 3>>;

// state, pressures, impulses on bodies, mean compression
using FluidStepped = std::tuple<Out<double, 3>, Out<double, 1>, Out<double, 3>, double>;
// points, numbers, tallies, residuals, states
using Triangulated =
    std::tuple<Out<double, 3>, Out<double, 3>, Out<double, 3>, Out<float, 4>, Out<std::uint8_t, 3>>;

BvhRows parse_bvh_rows(nb::bytes text, std::size_t columns, std::size_t limit, bool final);

nb::bytes format_bvh_rows(In<double, 2> values, In<std::int64_t, 1> decimals);

Out<double, 2> evaluate_curves(In<std::int64_t, 1> first, In<double, 1> times,
                               In<double, 1> values, In<std::int64_t, 1> kinds,
                               In<double, 2> ins, In<double, 2> outs, In<double, 2> at);

Out<double, 3> euler_to_quaternion(In<double, 2> values, In<std::int32_t, 2> columns,
                                   In<std::int32_t, 2> axes, In<double, 2> previous);

Out<double, 3> quaternion_to_euler(In<double, 3> quaternions, In<std::int32_t, 2> axes);

void forward_kinematics(In<std::int64_t, 1> parents, In<double, 3> translations,
                        In<double, 3> rotations, std::optional<In<double, 3>> scales,
                        Filled<double, 3> positions, Filled<double, 4> linear);

RoundingReport measure_rounding(In<std::int64_t, 1> parents, In<double, 3> translations,
                                In<double, 3> rotations, std::optional<In<double, 3>> scales,
                                In<float, 3> written_translations,
                                In<float, 3> written_rotations,
                                std::optional<In<float, 3>> written_scales);

FittedCubics fit_cubics(In<double, 2> values, In<double, 1> bounds,
                        In<std::int64_t, 1> anchors, In<double, 1> low, In<double, 1> high,
                        In<std::int64_t, 1> straight);

Out<double, 2> point_errors(In<double, 3> points, In<double, 3> true_positions,
                            In<double, 4> true_linear, In<double, 3> positions,
                            In<double, 4> linear);

void skin_linear(In<double, 3> points, In<std::int64_t, 1> first,
                 In<std::int32_t, 1> joints, In<double, 1> weights,
                 In<double, 4> transforms, bool normalize, Filled<double, 3> out);

void skin_dual_quaternion(In<double, 3> points, In<std::int64_t, 1> first,
                          In<std::int32_t, 1> joints, In<double, 1> weights,
                          In<double, 3> rotations, In<double, 3> translations,
                          std::optional<In<double, 4>> stretches, bool normalize,
                          Filled<double, 3> out);

Stretched split_stretch(In<double, 4> linear);

void add_sparse(In<double, 3> points, In<double, 2> weights, In<std::int64_t, 1> first,
                In<std::int32_t, 1> columns, In<double, 2> offsets,
                Filled<double, 3> out);

// Name, rows, width of a target, whether it misses lengths, whether CCD heeds it, of each.
nb::tuple ik_goal_kinds();

void place_ik_targets(Filled<double, 3> targets, In<double, 2> frames, double length);

IkSolved solve_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers, In<std::int64_t, 2> goals,
                  In<double, 2> goal_numbers, In<double, 2> starts, In<double, 3> targets,
                  In<double, 3> sought, In<double, 2> stretches, In<double, 2> rests,
                  double rest_weight, double length_tolerance, double angle_tolerance,
                  double damping, int iterations, int restarts, std::uint64_t seed,
                  double seconds, bool ordered, bool warm, int method);

IkLinearized linearize_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                          In<std::int64_t, 2> goals, In<double, 2> goal_numbers,
                          In<double, 2> starts, In<double, 3> targets, In<double, 2> steps);

IkSmoothed smooth_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                     In<std::int64_t, 2> goals, In<double, 2> goal_numbers, In<double, 2> path,
                     In<double, 3> targets, In<double, 3> sought, In<double, 2> stretches,
                     In<double, 2> drifts, double anchor, double speed, double acceleration,
                     std::size_t first, std::size_t end, double length_tolerance,
                     double angle_tolerance, double damping, int rounds);

IkFitted fit_ik(In<std::int64_t, 2> nodes, In<double, 2> numbers, In<std::int64_t, 2> goals,
                In<double, 2> goal_numbers, In<double, 2> path, In<double, 3> targets,
                In<double, 2> starts, double anchor, double speed, double acceleration,
                double robust, double rest_weight, double homing, std::size_t first,
                std::size_t end, int iterations, int rounds, bool tracked);

Out<std::int64_t, 1> cheapest_ik_path(In<std::int64_t, 2> nodes, In<double, 2> numbers,
                                      In<double, 3> paths, In<double, 2> costs,
                                      In<double, 2> drifts, In<double, 1> easy, bool open,
                                      bool closed);

Out<double, 3> point_extents(In<double, 3> points);

MeshTree build_mesh_tree(In<double, 2> points, In<std::int32_t, 2> triangles);

Collided collide_particles(ColliderArrays colliders, In<double, 3> before,
                           In<double, 3> after, In<double, 1> radii,
                           In<double, 1> begins, double step);

ColliderSamples sample_colliders(ColliderArrays colliders, In<double, 2> points, double share,
                                 double step);

std::tuple<Out<double, 2>, Out<double, 2>, double> crowd_step(
    In<double, 2> points, In<double, 2> velocities, In<double, 2> preferred,
    In<double, 1> radii, In<double, 1> most, In<double, 1> gives, In<std::int32_t, 1> groups,
    In<std::uint8_t, 1> does, In<std::int32_t, 1> starts, In<double, 2> walls, double sight,
    std::int64_t nearest, double horizon, double space, double push, double headway, double side, double step,
    std::int64_t rounds, double enough);
std::tuple<Out<bool, 1>, Out<double, 3>> fitting_spans(
    In<double, 3> turns, In<std::int64_t, 1> parents, In<std::int64_t, 1> numbers,
    In<double, 2> places, In<double, 2> before, In<double, 2> rest, In<std::int64_t, 1> feet,
    In<bool, 2> stands, In<std::int64_t, 1> begins, std::int64_t wide, double near,
    double standing, double hips);
Out<double, 2> travel_distances(In<bool, 2> free, double cell, In<std::int64_t, 1> seeds,
                                In<double, 1> starts);
FluidStepped fluid_steps(ColliderArrays colliders, In<std::int32_t, 1> owners,
                         In<double, 2> bodies, In<double, 3> state,
                         In<double, 2> accelerations, double spacing, double density,
                         double viscosity, double cohesion, double sound, double step,
                         std::int64_t parts);

Out<double, 1> fluid_densities(ColliderArrays colliders, In<double, 2> points, double spacing);

std::tuple<Out<double, 2>, Out<std::int32_t, 1>, double> flock_accelerations(
    In<double, 2> points, In<double, 2> velocities, std::optional<In<std::int32_t, 1>> members,
    std::optional<In<std::int32_t, 1>> others, double radius, double cosine,
    std::int64_t nearest, In<double, 1> attraction, In<double, 1> alignment,
    In<double, 1> repulsion, double softening, In<double, 2> period, double most);

std::tuple<Out<double, 2>, Out<double, 1>, Out<double, 1>> gravity(
    In<double, 2> points, In<double, 1> masses, double constant, double softening,
    double accuracy);

std::tuple<Out<std::int32_t, 1>, Out<std::int64_t, 1>, Out<std::int32_t, 1>> molecule_pairs(
    In<double, 2> points, In<double, 1> box, double reach, std::int64_t most);
std::tuple<Out<double, 2>, Out<double, 1>, double> molecule_forces(
    In<double, 2> points, In<std::int32_t, 1> order, In<std::int64_t, 1> starts,
    In<std::int32_t, 1> partners, In<double, 1> box, In<std::int32_t, 1> kinds,
    In<double, 3> forces, std::optional<In<double, 1>> charges, double cutoff, double onset,
    double damping);
// weights, poses, residuals, shares, rounds, change
using FittedFace = std::tuple<Out<double, 2>, Out<double, 2>, Out<double, 2>, Out<double, 2>, int,
                              double>;
FittedFace fit_face(In<double, 3> neutral, In<double, 3> deltas, In<double, 3> observed,
                    std::optional<In<double, 1>> camera, In<double, 2> poses,
                    In<double, 2> weights, double threshold, double smooth, double rest,
                    double enough, int rounds, bool warm);

Out<double, 2> curl_noise(In<double, 2> points, In<double, 1> times, std::uint64_t seed);

RoundedPoints round_points(In<double, 3> points, double unit);

Triangulated triangulate_points(In<double, 4> pixels, std::optional<In<double, 3>> confidences,
                                In<double, 2> cameras, In<bool, 2> active, In<double, 1> noise,
                                double gate, double condition, bool detailed);
Out<double, 2> least_median_residuals(In<double, 4> pixels, In<double, 2> cameras);

}  // namespace animtool
