// A step of rigid bodies under way: `solve.cpp` says how it goes.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "base/groups.h"
#include "rigid/drives.h"
#include "rigid/impacts.h"
#include "rigid/points.h"
#include "rigid/world.h"

namespace animtool::rigid {

// Of contacts and joints, how hard they are pushed back to where they should be: a frequency,
// over that of the small steps, and a damping ratio.
constexpr double STIFF = 0.35;
constexpr double CONTACT_DAMPING = 10, JOINT_DAMPING = 2;

class Solver {
 public:
  Solver(const World& world, std::vector<State>& states, std::vector<Kept>& kept,
         std::vector<std::array<double, ROWS>>& held, const std::vector<Vec>& forces,
         const std::vector<Vec>& torques, const std::vector<collide::Collider>& colliders,
         const std::vector<collide::Motion>& anchors, const Settings& settings, double step)
      : world_(world), states_(states), kept_(kept), held_(held), forces_(forces),
        torques_(torques), colliders_(colliders), anchors_(anchors), settings_(settings),
        step_(step), small_(step / settings.substeps), h_(small_), count_(states.size()) {}

  // Whether two approach so fast that they will bounce within the step.
  bool bounces();
  Report run();

 private:
  struct Island {
    std::vector<std::size_t> bodies, joints;
    std::vector<std::size_t> contacts;
    bool parting = false;  // somebody is still on the way out of another
  };
  void find();

  // ---- who is awake

  void begin_groups();
  bool sleeps(std::size_t i) const { return asleep(states_[i], settings_); }

  // Wakes those that somebody awake touches, with all that they touch.
  bool wake();
  void make_islands();

  // ---- one island

  void solve(Island& island);

  // Chooses small steps of an island, shorter where a drive swings in them.
  void divide(const Island& island);
  void resize(int parts);
  void soften();

  // Counts the points at which friction holds bodies: what slides is not held, and what is
  // round rolls on.
  void note_held(const Patch& patch);
  void refresh(std::size_t i);
  void add_patch(const Contact& c);

  // One point for both, so that no angular momentum is lost: halfway, or on what is round.
  static Vec touching_point(const Patch& patch, Vec own, Vec other) {
    const Contact& c = *patch.contact;
    if (c.radius > 0) return own + patch.normal * c.radius;
    if (c.other_radius > 0) return other - patch.normal * c.other_radius;
    return (own + other) * 0.5;
  }

  // What there is of a point of contact where it is now.
  void set_arms(const Patch& patch, Point& p, Vec at);

  // Begins with the forces of the step before.
  void find_kept(Patch& patch);
  void save(const Patch& patch);

  // ---- one small step

  // Goes from impact to impact, and what is left in one.
  void small_step(const Island& island, int s);

  // As RATTLE does (Andersen 1983): forces act for half the time, bodies go on with what leaves
  // joints and contacts right at the end, forces act for the other half, and velocities are made
  // right there.
  void advance(const Island& island, double time, double end);
  void begin_drives(const Joint& joint, std::size_t k);
  void end_drives(const Joint& joint, std::size_t k);
  template <typename Act>
  void each_drive(const Joint& joint, std::size_t k, Act act);

  // ---- impacts

  // How long nobody arrives who bounces, at most what is left; who is there bounces before.
  double until_impact(const Island& island, double left, double begin, double end);

  // Notes who comes so fast that he bounces; returns when the first arrives, or the time that
  // is left.
  double next_arrival(double left, double share);

  // When a point closes its gap as bodies go on and turn, within a time: by false position, of
  // Illinois.
  double arrival(const Patch& patch, const Point& p, double share, double within) const;
  double gap_at(const Patch& patch, const Point& p, double share, double time) const;

  // Speed below which two do not bounce but rest: forces on either bring back what is slower
  // within a small step.
  double rest_of(std::size_t a, std::size_t b, double restitution) const;
  double rest_of(const Patch& patch) const {
    return rest_of(patch.a, patch.b, patch.restitution);
  }

  // Where points are now.
  void look(double share);

  // Acceleration of the second as the first sees it.
  Vec relative_pull(const Patch& patch) const;
  static double pull_along(const Patch& patch, Vec pull) { return -dot(pull, patch.normal); }

  double approach(const Patch& patch, const Point& p) const {
    return speed_along(speeds_, patch, p, 0);
  }

  // Forces act for half a small step.
  void push(std::size_t i);

  void apply(std::size_t a, std::size_t b, Vec line, Vec turn_a, Vec turn_b, double impulse) {
    rigid::apply(speeds_, a, b, line, turn_a, turn_b, impulse);
  }

  // Contacts and joints hold for half the time what they held in the small step before.
  void begin_warm(Patch& patch, double scale);
  void end_warm(Patch& patch);
  void hold(const Patch& patch, const Point& p);
  void begin_warm(const Joint& joint, Rows& rows, double scale);
  void end_warm(const Joint& joint, Rows& rows);

  std::size_t first_of(const Joint& joint) const {
    return joint.a < 0 ? count_ : static_cast<std::size_t>(joint.a);
  }

  void hold(const Joint& joint, const Rows& rows);

  // The frames of a joint at a share of the step, and the arms to them.
  struct Frames {
    Anchor a, b;
    Vec arm_a, arm_b;
  };
  Frames frames_of(std::size_t number, double share, const State* on_a, const State& on_b) const;

  const State* first_state(const Joint& joint) const {
    return joint.a < 0 ? nullptr : &states_[static_cast<std::size_t>(joint.a)];
  }

  void write_rows(std::size_t number, std::size_t k, double share, bool first);

  // How much more a joint's errors change until the end of the small step than its equations
  // say, as bodies go on and turn: over the time.
  void bend(std::size_t number, Rows& rows, double end);

  double speed_of(const Joint& joint, const Row& row) const {
    const Speed &a = speeds_[first_of(joint)], &b = speeds_[joint.b];
    return dot(row.line, b.v - a.v) + dot(row.arm_b, b.w) - dot(row.arm_a, a.w) + row.given;
  }

  static Turn turn_of_pose(const Pose& pose);
  static Anchor anchor_of(const State& s, const Frame& frame);

  // Corrects velocities until they hardly change: with or without what pushes back to where
  // bodies should be.
  void iterate(const Island& island, bool pushing);
  double correct(Patch& patch, bool pushing);
  double correct(const Joint& joint, Rows& rows, bool pushing);

  // Bodies go on for a small step.
  void go(std::size_t i);
  void turn_freely(std::size_t i, State& s) const;
  Vec momentum_of(std::size_t i) const;

  // Notes whom contacts and joints push.
  void mark(const Island& island);

  // Velocities as states have them.
  void settle(std::size_t i);

  // ---- what is kept

  void keep();

  // Lets islands fall asleep that have been slow for long enough and that friction holds. What
  // nothing holds, or only a joint, goes on however slow it is, until it hardly moves at all.
  void rest();

  // Whether anything holds an island; without, it is at rest only where nothing pulls.
  bool supported(const Island& island) const;

  const World& world_;
  std::vector<State>& states_;
  std::vector<Kept>& kept_;
  std::vector<std::array<double, ROWS>>& held_;
  const std::vector<Vec>&forces_, &torques_;
  const std::vector<collide::Collider>& colliders_;
  const std::vector<collide::Motion>& anchors_;
  const Settings& settings_;
  double step_, small_, h_;  // whole, of small steps, and from impact to impact [s]
  std::size_t count_;
  Softness contact_ = Softness::of(STIFF / small_, CONTACT_DAMPING, h_);
  Softness joint_ = Softness::of(STIFF / small_, JOINT_DAMPING, h_);
  std::vector<Contact> contacts_;
  bool found_ = false;  // contacts, of this step
  Groups groups_;
  std::vector<Island> islands_;
  std::vector<Speed> speeds_;  // of the bodies, and of what does not move
  std::vector<Pose> turns_;
  std::vector<char> pushed_;
  std::vector<int> held_at_;  // points
  int parts_ = 1;  // small steps
  std::vector<Drives> drives_;
  bool hard_ = false;  // whether joints give way to nothing, so that drives move what they should
  bool bouncy_ = false;  // whether somebody may bounce
  std::vector<Patch> patches_;
  std::vector<Point> points_;
  std::vector<Rows> rows_;
  std::vector<Kept> saved_;
  Report report_;
};

}  // namespace animtool::rigid
