// Arrays of rigid bodies, from and to Python.
#include "rigid/bodies.h"

#include <algorithm>

#include "base/checks.h"
#include "colliders/arrays.h"

namespace animtool {

namespace {

using collide::load;
using collide::store;
using rigid::Quaternion;
using rigid::Vec;

// Numbers of a body's state, of a joint, of a contact, and of a pose.
constexpr std::size_t STATE_SIZE = 14, JOINT_SIZE = 27, CONTACT_SIZE = 6, POSE_SIZE = 7;

Quaternion read_rotation(const double* p) { return unit(Quaternion{p[0], p[1], p[2], p[3]}); }

void check_rotation(const char* name, const double* p) {
  if (!(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3] > 1e-20))
    check::refuse(name, "a rotation has no direction");
}

// Checks that the starts of rows ascend from 0 to an end.
void check_starts(const char* name, const In<std::int64_t, 1>& starts, std::size_t count,
                  std::size_t end) {
  check::shape(name, starts, {count + 1});
  const std::int64_t* values = starts.data();
  for (std::size_t i = 0; i < count; ++i)
    if (values[i] > values[i + 1]) check::refuse(name, "they do not ascend");
  if (values[0] != 0 || values[count] != static_cast<std::int64_t>(end))
    check::refuse(name, "they are not from 0 to " + check::text(static_cast<std::int64_t>(end)));
}

}  // namespace

RigidBodies::RigidBodies(In<double, 2> inertias, In<std::int64_t, 1> bodies,
                         In<double, 2> shape_numbers, In<double, 2> points,
                         In<std::int64_t, 1> point_starts, In<std::int64_t, 1> face_starts,
                         In<std::int64_t, 1> corner_starts, In<std::int64_t, 1> corners,
                         In<std::int64_t, 2> joints, In<double, 2> joint_numbers,
                         In<std::int64_t, 2> excluded_pairs) {
  const std::size_t count = inertias.shape(0), shape_count = bodies.shape(0);
  check::numbers("inertias", inertias, {check::ANY, 4});
  check::at_most("inertias", count, check::MAX_ROWS);
  check::at_most("bodies", shape_count, check::MAX_ROWS);
  check::indices("bodies", bodies, 0, static_cast<std::int64_t>(count));
  check::numbers("shape_numbers", shape_numbers, {shape_count, 3});
  check::numbers("points", points, {check::ANY, 3});
  check_starts("point_starts", point_starts, shape_count, points.shape(0));
  const std::size_t face_count = corner_starts.shape(0) ? corner_starts.shape(0) - 1 : 0;
  check_starts("face_starts", face_starts, shape_count, face_count);
  check_starts("corner_starts", corner_starts, face_count, corners.shape(0));
  world_.bodies.resize(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double* inertia = inertias.data() + 4 * i;
    check::positive("inertias", inertia[0]);
    world_.bodies[i].inverse_mass = 1 / inertia[0];
    for (int k = 0; k < 3; ++k) {
      check::non_negative("inertias", inertia[k + 1]);
      world_.bodies[i].inverse_inertia.entries[k] = inertia[k + 1] > 0 ? 1 / inertia[k + 1] : 0;
    }
  }
  world_.shapes.resize(shape_count);
  for (std::size_t s = 0; s < shape_count; ++s) {
    rigid::Shape& shape = world_.shapes[s];
    shape.body = static_cast<std::size_t>(bodies.data()[s]);
    if (s && shape.body < world_.shapes[s - 1].body) check::refuse("bodies", "they do not ascend");
    const double* n = shape_numbers.data() + 3 * s;
    check::non_negative("shape_numbers", n[0]);
    check::between("shape_numbers", n[1], 0, 1);
    check::non_negative("shape_numbers", n[2]);
    shape.core.radius = n[0], shape.material = {n[1], n[2]};
    const std::int64_t first_point = point_starts.data()[s], end_point = point_starts.data()[s + 1];
    if (first_point == end_point) check::refuse("point_starts", "a shape has no points");
    for (std::int64_t p = first_point; p < end_point; ++p)
      shape.core.points.push_back(load(points.data() + 3 * p));
    for (std::int64_t f = face_starts.data()[s]; f < face_starts.data()[s + 1]; ++f) {
      const std::int64_t a = corner_starts.data()[f], b = corner_starts.data()[f + 1];
      if (b - a < 3) check::refuse("corner_starts", "a face has fewer than 3 corners");
      check::indices("corners", corners.data() + a, static_cast<std::size_t>(b - a), 0,
                     end_point - first_point);
      for (std::int64_t k = a; k < b; ++k)
        shape.core.face_corners.push_back(static_cast<int>(corners.data()[k]));
      shape.core.face_starts.push_back(static_cast<int>(shape.core.face_corners.size()));
    }
    if (shape.core.face_starts.size() == 1 && end_point - first_point > 2)
      check::refuse("face_starts", "a shape of more than two points has no faces");
    shape.core.build_faces();
    rigid::Body& body = world_.bodies[shape.body];
    body.bounding_radius = std::max(body.bounding_radius, shape.core.bounding_radius);
  }
  read_joints(joints, joint_numbers);
  check::shape("excluded_pairs", excluded_pairs, {check::ANY, 2});
  check::at_most("excluded_pairs", excluded_pairs.shape(0), check::MAX_ROWS);
  for (std::size_t k = 0; k < excluded_pairs.shape(0); ++k) {
    check::between("excluded_pairs", excluded_pairs.data()[2 * k], 0,
                   static_cast<std::int64_t>(count) - 1);
    check::between("excluded_pairs", excluded_pairs.data()[2 * k + 1], 0,
                   static_cast<std::int64_t>(count + check::MAX_ROWS));
  }
  for (std::size_t k = 0; k < excluded_pairs.shape(0); ++k)
    exclude(excluded_pairs.data()[2 * k], excluded_pairs.data()[2 * k + 1]);
  std::sort(world_.excluded_pairs.begin(), world_.excluded_pairs.end());
}

void RigidBodies::read_joints(const In<std::int64_t, 2>& joints, const In<double, 2>& numbers) {
  const std::size_t count = joints.shape(0);
  check::shape("joints", joints, {check::ANY, 3});
  check::numbers("joint_numbers", numbers, {count, JOINT_SIZE});
  const auto body_count = static_cast<std::int64_t>(world_.bodies.size());
  for (std::size_t k = 0; k < count; ++k) {
    const std::int64_t* row = joints.data() + 3 * k;
    const double* n = numbers.data() + JOINT_SIZE * k;
    check::between("joints", row[0], 0, 3);
    check::between("joints", row[1], -1, body_count - 1);
    check::between("joints", row[2], 0, body_count - 1);
    if (row[1] == row[2]) check::refuse("joints", "a body is joined to itself");
    for (const int index : {3, 10, 19}) check_rotation("joint_numbers", n + index);
    rigid::Joint joint;
    joint.kind = static_cast<rigid::JointKind>(row[0]);
    joint.a = row[1], joint.b = static_cast<std::size_t>(row[2]);
    joint.frame_a = {load(n), read_rotation(n + 3)},
    joint.frame_b = {load(n + 7), read_rotation(n + 10)};
    joint.low_limit = n[14], joint.high_limit = n[15], joint.swing[0] = n[16],
    joint.swing[1] = n[17];
    joint.target = n[18], joint.target_rotation = read_rotation(n + 19);
    check::non_negative("joint_numbers", n[23]);
    check::non_negative("joint_numbers", n[24]);
    joint.stiffness = n[23], joint.damping = n[24], joint.max_force = n[25];
    joint.speed = n[26];
    world_.joints.push_back(joint);
  }
}

void RigidBodies::exclude(std::int64_t first, std::int64_t second) {
  const auto a = static_cast<std::uint64_t>(first), b = static_cast<std::uint64_t>(second);
  world_.excluded_pairs.push_back(std::min(a, b) << 32 | std::max(a, b));
}

RigidStepResult step_rigid(const RigidBodies& bodies, In<double, 2> state,
                           In<std::int64_t, 2> pairs, In<double, 2> contacts,
                           In<double, 2> joint_impulses, In<double, 2> forces,
                           ColliderArrays colliders, In<double, 3> anchors, double step,
                           std::int64_t method, std::int64_t substeps, std::int64_t max_iterations,
                           double tolerance, double sleep_speed, double sleep_time) {
  const rigid::World& world = bodies.world();
  const std::size_t count = world.bodies.size(), joint_count = world.joints.size();
  const std::size_t stored_count = pairs.shape(0);
  check::numbers("state", state, {count, STATE_SIZE});
  check::shape("pairs", pairs, {check::ANY, 2});
  check::numbers("contacts", contacts, {stored_count, CONTACT_SIZE});
  check::numbers("joint_impulses", joint_impulses, {joint_count, rigid::JOINT_SLOT_COUNT});
  check::numbers("forces", forces, {count, 6});
  check::numbers("anchors", anchors, {joint_count, 2, POSE_SIZE});
  check::positive("step", step);
  check::between("method", method, 0, 3);
  check::between("substeps", substeps, 1, 1000);
  check::between("max_iterations", max_iterations, 1, 100000);
  check::non_negative("tolerance", tolerance);
  check::non_negative("sleep_speed", sleep_speed);
  check::non_negative("sleep_time", sleep_time);
  const std::vector<collide::Collider> world_colliders = read_colliders(colliders);
  const auto shape_count = static_cast<std::int64_t>(world.shapes.size());
  std::vector<rigid::State> states(count);
  for (std::size_t i = 0; i < count; ++i) {
    const double* row = state.data() + STATE_SIZE * i;
    check_rotation("state", row + 3);
    states[i] = {load(row), load(row + 7), load(row + 10), read_rotation(row + 3), row[13]};
  }
  std::vector<rigid::StoredContact> stored_contacts(stored_count);
  for (std::size_t i = 0; i < stored_count; ++i) {
    const std::int64_t* pair = pairs.data() + 2 * i;
    check::between("pairs", pair[0], 0, shape_count - 1);
    check::between("pairs", pair[1], 0,
                   shape_count + static_cast<std::int64_t>(world_colliders.size()) - 1);
    stored_contacts[i] = {pair[0], pair[1], load(contacts.data() + CONTACT_SIZE * i),
                          load(contacts.data() + CONTACT_SIZE * i + 3)};
    if (i && (stored_contacts[i].first_shape != stored_contacts[i - 1].first_shape
                  ? stored_contacts[i].first_shape < stored_contacts[i - 1].first_shape
                  : stored_contacts[i].second_shape < stored_contacts[i - 1].second_shape))
      check::refuse("pairs", "they do not ascend");
  }
  std::vector<std::array<double, rigid::JOINT_SLOT_COUNT>> impulses(joint_count);
  std::vector<collide::Motion> anchor_motions(joint_count);
  for (std::size_t k = 0; k < joint_count; ++k) {
    std::copy_n(joint_impulses.data() + rigid::JOINT_SLOT_COUNT * k, rigid::JOINT_SLOT_COUNT,
                impulses[k].begin());
    const double* pose = anchors.data() + 2 * POSE_SIZE * k;
    check_rotation("anchors", pose + 3), check_rotation("anchors", pose + POSE_SIZE + 3);
    anchor_motions[k] = collide::Motion(pose, pose + POSE_SIZE);
  }
  rigid::Report report;
  std::vector<Vec> body_forces(count), body_torques(count);
  for (std::size_t i = 0; i < count; ++i) {
    body_forces[i] = load(forces.data() + 6 * i), body_torques[i] = load(forces.data() + 6 * i + 3);
  }
  const rigid::Settings settings{static_cast<rigid::Method>(method),
                                 static_cast<int>(substeps),
                                 static_cast<int>(max_iterations),
                                 tolerance,
                                 sleep_speed,
                                 sleep_time};
  report = rigid::step_world(world, states, stored_contacts, impulses, body_forces, body_torques,
                             world_colliders, anchor_motions, settings, step);
  Out<double, 2> new_states(count, STATE_SIZE), contact_rows(stored_contacts.size(), CONTACT_SIZE),
      joint_rows(joint_count, rigid::JOINT_SLOT_COUNT);
  Out<std::int64_t, 2> contact_pairs(stored_contacts.size(), 2);
  for (std::size_t i = 0; i < count; ++i) {
    double* row = new_states.get() + STATE_SIZE * i;
    const rigid::State& body_state = states[i];
    store(body_state.position, row), store(body_state.velocity, row + 7),
        store(body_state.momentum, row + 10);
    row[3] = body_state.rotation.x, row[4] = body_state.rotation.y, row[5] = body_state.rotation.z,
    row[6] = body_state.rotation.w, row[13] = body_state.slow_time;
  }
  for (std::size_t i = 0; i < stored_contacts.size(); ++i) {
    contact_pairs.get()[2 * i] = stored_contacts[i].first_shape,
                            contact_pairs.get()[2 * i + 1] = stored_contacts[i].second_shape;
    store(stored_contacts[i].position, contact_rows.get() + CONTACT_SIZE * i),
        store(stored_contacts[i].force, contact_rows.get() + CONTACT_SIZE * i + 3);
  }
  for (std::size_t k = 0; k < joint_count; ++k)
    std::copy_n(impulses[k].begin(), rigid::JOINT_SLOT_COUNT,
                joint_rows.get() + rigid::JOINT_SLOT_COUNT * k);
  return {std::move(new_states),   std::move(contact_pairs),
          std::move(contact_rows), std::move(joint_rows),
          report.max_depth,        report.residual,
          report.contact_count,    report.iteration_count,
          report.awake_count,      report.unsolved_count,
          report.first_shape,      report.second_shape,
          report.drive_step,       report.drive};
}

}  // namespace animtool
