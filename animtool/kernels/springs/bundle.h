// Four strands side by side over a frame, in small steps: compliant springs are projected one
// after the other, stiff springs along the strand are solved by a tridiagonal system.
//
// T.-H. Han, T. Harada, Tridiagonal Matrix Formulation for Inextensible Hair Strand
// Simulation, 2013; M. Macklin et al., Small Steps in Physics Simulation, 2019.
#pragma once

#include <cstddef>
#include <cstdint>

#include "colliders/wide.h"
#include "springs/rows.h"

namespace animtool {

// What colliders that are no rods answer, asked for one particle: of row (step, C). As the
// step begins or as it ends, a distance and the way out; whether what goes far is stopped.
struct OtherColliders {
  const void* all;
  void (*sample)(const void* all, std::size_t row, bool end, const double* point,
                 double* distance_and_normal);
  bool (*sweep)(const void* all, std::size_t row, const double* from, double* to);
};

struct StrandBundle;

// Segments of strands against what is finer than these: of one of four strands in a step, by
// particles that are near. Returns whether it moved any, and adds how far to their ways.
struct SegmentContacts {
  void* all = nullptr;  // null where nothing is that fine
  bool (*settle)(void* all, StrandBundle& bundle, std::size_t step, std::size_t lane,
                 std::size_t near) = nullptr;
  double reach = 0;  // a particle this far from all colliders has no segment at them
};

// Constants of a frame, shared by all strands.
struct StrandSteps {
  std::size_t points, cells, substeps;
  double h;
  double fall[3];  // what gravity adds to velocities in a step
  double slowed;   // what drag leaves of them
  // Compliances: of folds, and at the root; of the pull to the animation, by position and
  // by velocity; of springs along the strand.
  double fold, root_fold, draw, draw_change, soft;
  double longest;  // that springs along the strand may be, over their length at rest
  std::size_t colliders;
  const collide::Rod* rods;   // (steps, C)
  // Which are rods, and of which it is known how far their surfaces move (C,).
  const unsigned char *is_rod, *is_bounded;
  std::size_t depth_rows;  // the first colliders, which have allowed depths
  const double* thicknesses;  // (C,)
  // How all go on in each step, (steps, 3), and how far the surfaces of rods go beside that
  // from each step on, to the end of the frame, (steps + 1, C).
  const double *drifts, *remaining;
  OtherColliders others;
  double tolerance;
};

// Four strands of P particles; vectors are (P, 3, 4).
struct StrandBundle {
  double *x, *before, *v;
  double* unmoved;  // where those that are moved out slowly would have stood still from
  const double* goals;  // (cells + 1, P, 3, 4)
  const double *rests, *folds;
  // How deep particles may be: of each strand in the first collider, the next so much on.
  const double* depths[WIDE];
  std::size_t next_depths;
  unsigned counted;  // bits of those that are not there only to fill up
  // Room: along each spring (P, 3, 4), and of the matrix (P, 3, 4).
  double *along, *matrix;
  // How far each particle went beside the drift (P,), at which way it may meet any collider
  // (P,), and each (P, C); those that are near (C,).
  double *shift, *due, *dues;
  std::size_t* near;
  SegmentContacts segments;
  std::int32_t* at_segments;  // those with a segment near a collider (P,)
  // Results: particles moved by colliders in each step, summed; left inside; the largest
  // strain.
  std::int64_t* touched;
  std::int64_t inside;
  double stretch;
};

// Length corrections in a step; the first is for all strands.
constexpr int CORRECTIONS = 4;
// Length corrections after collisions, each followed by collisions.
constexpr int YIELDS = 5;
// Rounds of resolving all colliders.
constexpr int ROUNDS_OUT = 3;
// Colliders that are farther off than this at the begin of a frame [m] are hardly met in it.
constexpr double NEAR = 0.1;

template <class On>
class BundleCrossing {
  using N = Four<On>;
  using V = FourVec<On>;

 public:
  BundleCrossing(const StrandSteps& plan, StrandBundle& bundle) : plan_(plan), b_(bundle) {}

  void cross() {
    look_about();
    const double rate = 1 / plan_.h;
    for (std::size_t cell = 0; cell < plan_.cells; ++cell)
      for (std::size_t j = 0; j < plan_.substeps; ++j) {
        const double parts = static_cast<double>(plan_.substeps);
        first_ = b_.goals + cell * WIDE_VECTOR * plan_.points;
        was_ = static_cast<double>(j) / parts;
        is_ = static_cast<double>(j + 1) / parts;
        predict();
        fold();
        draw();
        N some = below(N(0.0), N(1.0));
        for (int i = 0; i < CORRECTIONS && bits(some); ++i) {
          correct<false>(some);
          some = too_long();
        }
        keep_out(cell * plan_.substeps + j);
        for (std::size_t p = 0; p < plan_.points; ++p)
          ((at(b_.x, p) - at(b_.unmoved, p)) * rate).store(b_.v + WIDE_VECTOR * p);
      }
    b_.inside = left_inside();
    b_.stretch = longest();
  }

 private:
  static V at(const double* rows, std::size_t p) { return V::of(rows + WIDE_VECTOR * p); }

  // Where the animation has a particle at a share of the cell; at its ends to the bit.
  V goal(std::size_t p, double fraction) const {
    return at(first_, p) * (1 - fraction) + at(first_ + WIDE_VECTOR * plan_.points, p) * fraction;
  }

  void predict() {
    const V fall = V::spread(plan_.fall);
    at(b_.x, 0).store(b_.before);
    at(b_.x, 0).store(b_.unmoved);
    goal(0, is_).store(b_.x);
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V x = at(b_.x, p);
      x.store(b_.before + WIDE_VECTOR * p);
      x.store(b_.unmoved + WIDE_VECTOR * p);
      const V v = (at(b_.v, p) + fall) * plan_.slowed;
      (x + v * plan_.h).store(b_.x + WIDE_VECTOR * p);
    }
  }

  void fold() {
    if (plan_.fold == 0) return;
    for (std::size_t p = 0; p + 2 < plan_.points; ++p) {
      const V a = at(b_.x, p), b = at(b_.x, p + 2), d = b - a;
      const N square = dot(d, d), rest = N::of(b_.folds + WIDE * p);
      // Ends at one place have no direction, and no pull.
      const N one = chosen(below(N(0.0), square), N(1.0), N(0.0));
      const N beyond = one - rest * (root(square) * inverse(square));
      const V pull = d * (beyond * (p == 0 ? plan_.root_fold : plan_.fold));
      if (p > 0) (a + pull).store(b_.x + WIDE_VECTOR * p);
      (b - pull).store(b_.x + WIDE_VECTOR * (p + 2));
    }
  }

  void draw() {
    if (plan_.draw == 0) return;
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V x = at(b_.x, p), off = goal(p, is_) - x;
      const V went = off - (goal(p, was_) - at(b_.before, p));
      (x + off * plan_.draw + went * plan_.draw_change).store(b_.x + WIDE_VECTOR * p);
    }
  }

  // Which strands have a spring that is longer than it may be: those that turn far in a step.
  N too_long() const {
    N hit = below(N(0.0), N(0.0));
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V d = at(b_.x, p) - at(b_.x, p - 1);
      const N most = N::of(b_.rests + WIDE * (p - 1)) * plan_.longest;
      hit = either(hit, below(most * most, dot(d, d)));
    }
    return hit;
  }

  // One correction of Newton's for all lengths along some of the strands: each spring's pull
  // moves those before and behind it, so that the matrix has three diagonals. Particles are
  // known to be on their way, or it is noted how far they go.
  template <bool Noted>
  void correct(const N& some) {
    V before{0.0, 0.0, 0.0};
    N fraction(0.0), sum(0.0);
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V d = at(b_.x, p) - at(b_.x, p - 1);
      const N size = length(d);
      const V along = d * inverse(size);
      // Between springs that share a particle; the root gives way to none.
      const N shared = dot(before, along);
      const N full = N((p == 1 ? 1 : 2) + plan_.soft) - shared * shared * fraction;
      sum = size - N::of(b_.rests + WIDE * (p - 1)) + shared * fraction * sum;
      fraction = N(1.0) / full;
      along.store(b_.along + WIDE_VECTOR * p);
      double* row = b_.matrix + WIDE_VECTOR * p;
      shared.store(row);
      fraction.store(row + WIDE);
      sum.store(row + 2 * WIDE);
      before = along;
    }
    N pull(0.0), shared(0.0);
    V behind{0.0, 0.0, 0.0};
    for (std::size_t p = plan_.points; p-- > 1;) {
      const double* row = b_.matrix + WIDE_VECTOR * p;
      pull = (N::of(row + 2 * WIDE) + shared * pull) * N::of(row + WIDE);
      shared = N::of(row);
      const V back = at(b_.along, p) * pull;
      const V x = at(b_.x, p), move = chosen(some, behind - back, V{0.0, 0.0, 0.0});
      (x + move).store(b_.x + WIDE_VECTOR * p);
      if constexpr (Noted) b_.shift[p] += largest(length(move));
      behind = back;
    }
  }

  static N length(const V& a) { return root(dot(a, a)); }

  // The part of the strands, of four from root to tip, that a point is in.
  std::size_t part(std::size_t p) const { return p * WIDE / plan_.points; }

  // A ball about each part of all the strands together: its centre and its radius. Returns
  // which parts there are: strands of few points do not have all.
  unsigned surround(V& centre, N& radius) const {
    unsigned parts = 0;
    double low[3][WIDE], high[3][WIDE];
    for (std::size_t k = 0; k < 3; ++k)
      for (std::size_t g = 0; g < WIDE; ++g) low[k][g] = NEVER, high[k][g] = -NEVER;
    for (std::size_t p = 0; p < plan_.points; ++p) {
      const std::size_t g = part(p);
      parts |= 1u << g;
      for (std::size_t k = 0; k < 3; ++k) {
        const N row = N::of(b_.x + WIDE_VECTOR * p + WIDE * k);
        const double least = smallest(row), most = largest(row);
        low[k][g] = least < low[k][g] ? least : low[k][g];
        high[k][g] = most > high[k][g] ? most : high[k][g];
      }
    }
    const V from = V::of(low[0]), half = (V::of(high[0]) - from) * 0.5;
    centre = from + half;
    radius = length(half);
    return parts;
  }

  // How far the parts of the strands are from each collider as the frame begins.
  void look_about() {
    near_ = 0;
    far_ = NEVER;
    if (plan_.colliders == 0) return;
    V centre;
    N radius;
    const unsigned parts = surround(centre, radius);
    for (std::size_t c = 0; c < plan_.colliders; ++c) {
      double off[WIDE] = {0, 0, 0, 0};
      if (plan_.is_rod[c]) {
        const collide::Rod& rod = plan_.rods[c];
        const N away = sample_rod(rod.begin, rod.radius, centre).distance - radius;
        (most(away, N(0.0)) - plan_.remaining[c]).store(off);
      }
      double nearest = NEVER;
      for (std::size_t g = 0; g < WIDE; ++g)
        if ((parts >> g & 1) && off[g] < nearest) nearest = off[g];
      if (nearest >= NEAR) {
        far_ = nearest < far_ ? nearest : far_;
        continue;
      }
      b_.near[near_++] = c;
      for (std::size_t p = 0; p < plan_.points; ++p)
        b_.dues[p * plan_.colliders + c] = off[part(p)];
    }
    for (std::size_t p = 0; p < plan_.points; ++p) {
      b_.shift[p] = 0;
      b_.due[p] = next_due(p);
    }
  }

  // The way at which a particle may meet the next collider.
  double next_due(std::size_t p) const {
    const double* dues = b_.dues + p * plan_.colliders;
    double next = far_;
    for (std::size_t k = 0; k < near_; ++k) {
      const double one = dues[b_.near[k]];
      next = one < next ? one : next;
    }
    return next;
  }

  // Colliders have the last word of each step; strands that they drew out give way first.
  void keep_out(std::size_t step) {
    if (plan_.colliders == 0) return;
    const V drift = V::spread(plan_.drifts + 3 * step);
    for (std::size_t p = 1; p < plan_.points; ++p)
      b_.shift[p] += largest(length(at(b_.x, p) - at(b_.before, p) - drift));
    unsigned touched = 0;
    allow(ALL);
    unsigned moved = meet(step, touched);
    b_.touched[step] += touched;
    for (int i = 0; i < YIELDS && moved; ++i) {
      moved &= bits(too_long());
      if (!moved) break;
      allow(moved);
      correct<true>(allowed_);
      moved &= meet(step, touched);
    }
  }

  // Colliders move some of the strands.
  void allow(unsigned some) {
    double lanes[WIDE];
    for (std::size_t l = 0; l < WIDE; ++l) lanes[l] = some >> l & 1;
    allowed_ = below(N(0.0), N::of(lanes));
    allowed_bits_ = some;
  }

  // Moves particles out of colliders; returns in which strands.
  unsigned meet(std::size_t step, unsigned& touched) {
    unsigned lanes = 0;
    for (std::size_t p = 1; p < plan_.points; ++p) {
      if (b_.shift[p] < b_.due[p]) continue;
      if (b_.shift[p] >= far_) look_at_all();
      const double went = largest(length(at(b_.x, p) - at(b_.before, p)));
      const unsigned moved = settle(step, p, went);
      touched += count(moved);
      lanes |= moved;
    }
    return b_.segments.all ? lanes | meet_segments(step) : lanes;
  }

  // The same of segments between particles; the root is near where another is.
  unsigned meet_segments(std::size_t step) {
    std::size_t near = 0;
    b_.at_segments[near++] = 0;
    for (std::size_t p = 1; p < plan_.points; ++p)
      if (b_.shift[p] + b_.segments.reach >= b_.due[p])
        b_.at_segments[near++] = static_cast<std::int32_t>(p);
    unsigned lanes = 0;
    for (std::size_t l = 0; near > 1 && l < WIDE; ++l) {
      if (!((allowed_bits_ & b_.counted) >> l & 1)) continue;
      if (b_.segments.settle(b_.segments.all, b_, step, l, near)) lanes |= 1u << l;
    }
    return lanes;
  }

  void look_at_all() {
    const std::size_t count = plan_.colliders;
    for (std::size_t c = 0; c < count; ++c) {
      bool known = false;
      for (std::size_t k = 0; k < near_; ++k) known = known || b_.near[k] == c;
      for (std::size_t p = 0; !known && p < plan_.points; ++p) b_.dues[p * count + c] = 0;
    }
    for (near_ = 0; near_ < count; ++near_) b_.near[near_] = near_;
    for (std::size_t p = 0; p < plan_.points; ++p) b_.due[p] = 0;
    far_ = NEVER;
  }

  unsigned count(unsigned bits) const {
    unsigned hit = 0;
    for (bits &= b_.counted; bits; bits &= bits - 1) ++hit;
    return hit;
  }

  // Brings four particles out of what they may be in; returns which were moved.
  unsigned settle(std::size_t step, std::size_t p, double went) {
    double &shift = b_.shift[p], *dues = b_.dues + p * plan_.colliders;
    const V from = at(b_.before, p);
    V to = at(b_.x, p), unmoved = at(b_.unmoved, p);
    unsigned moved = sweep(step, p, went, from, to);
    for (int round = 0; round < ROUNDS_OUT; ++round) {
      unsigned pushed = 0;
      std::size_t looked = 0, only = 0;
      for (std::size_t k = 0; k < near_; ++k) {
        const std::size_t c = b_.near[k];
        if (dues[c] > shift) continue;
        ++looked;
        only = c;
        pushed |= push(step, p, c, from, to, unmoved);
      }
      // What is pushed may come near what was far.
      if (shift >= far_) look_at_all();
      moved |= pushed;
      if (!pushed || (looked == 1 && !any_due(dues, shift, only))) break;
    }
    b_.due[p] = next_due(p);
    to.store(b_.x + WIDE_VECTOR * p);
    unmoved.store(b_.unmoved + WIDE_VECTOR * p);
    return moved;
  }

  bool any_due(const double* dues, double shift, std::size_t but) const {
    for (std::size_t k = 0; k < near_; ++k)
      if (b_.near[k] != but && dues[b_.near[k]] <= shift) return true;
    return false;
  }

  unsigned push(std::size_t step, std::size_t p, std::size_t c, const V& from, V& to,
                V& unmoved) {
    const std::size_t row = step * plan_.colliders + c;
    const collide::Rod& rod = plan_.rods[row];
    double &shift = b_.shift[p], &due = b_.dues[p * plan_.colliders + c];
    const auto hit = sample(row, c, true, to);
    const double remaining = plan_.remaining[row + plan_.colliders];
    const double nearest = smallest(hit.distance);
    due = plan_.is_bounded[c] && nearest > remaining ? shift + (nearest - remaining) : shift;
    if (!(nearest < -collide::TOUCH)) return 0;
    const N depth = depths(p, c);
    if (!(smallest(hit.distance - depth) < -collide::TOUCH)) return 0;
    const N begun = sample(row, c, false, from).distance;
    V location = to, stood = unmoved;
    const unsigned pushed =
        allowed_bits_ & collide::push_out(rod, hit, begun, depth, from, location, stood);
    if (!pushed) return 0;
    location = chosen(allowed_, location, to);
    unmoved = chosen(allowed_, stood, unmoved);
    shift += largest(length(location - to));
    due = shift;
    to = location;
    return pushed;
  }

  N depths(std::size_t p, std::size_t c) const {
    if (!b_.depths[0] || c >= plan_.depth_rows) return N(0.0);
    double hit[WIDE];
    for (std::size_t l = 0; l < WIDE; ++l) hit[l] = b_.depths[l][c * b_.next_depths + p];
    return N::of(hit);
  }

  collide::WideSample<N> sample(std::size_t row, std::size_t c, bool end, const V& at) const {
    const collide::Rod& rod = plan_.rods[row];
    if (plan_.is_rod[c])
      return collide::sample_rod(end ? rod.end : rod.begin, rod.radius, at);
    double points[WIDE_VECTOR], answers[WIDE][WIDE];
    at.store(points);
    for (std::size_t l = 0; l < WIDE; ++l) {
      const double point[3] = {points[l], points[WIDE + l], points[2 * WIDE + l]};
      plan_.others.sample(plan_.others.all, row, end, point, answers[l]);
    }
    double columns[WIDE][WIDE];
    for (std::size_t k = 0; k < WIDE; ++k)
      for (std::size_t l = 0; l < WIDE; ++l) columns[k][l] = answers[l][k];
    return {N::of(columns[0]), {N::of(columns[1]), N::of(columns[2]), N::of(columns[3])}};
  }

  // Stops particles that move farther than the thickness of colliders (continuous collision).
  unsigned sweep(std::size_t step, std::size_t p, double went, const V& from, V& to) {
    double &shift = b_.shift[p], *dues = b_.dues + p * plan_.colliders;
    unsigned stopped = 0;
    for (std::size_t k = 0; k < near_; ++k) {
      const std::size_t c = b_.near[k];
      if (dues[c] > shift || went <= plan_.thicknesses[c]) continue;
      double begins[WIDE_VECTOR], ends[WIDE_VECTOR];
      from.store(begins);
      to.store(ends);
      for (std::size_t l = 0; l < WIDE; ++l) {
        const double begin[3] = {begins[l], begins[WIDE + l], begins[2 * WIDE + l]};
        double end[3] = {ends[l], ends[WIDE + l], ends[2 * WIDE + l]};
        const std::size_t row = step * plan_.colliders + c;
        if (!(allowed_bits_ >> l & 1)) continue;
        if (!plan_.others.sweep(plan_.others.all, row, begin, end)) continue;
        for (std::size_t k = 0; k < 3; ++k) ends[k * WIDE + l] = end[k];
        stopped |= 1u << l;
      }
      const V location = V::of(ends);
      shift += largest(length(location - to));
      to = location;
    }
    return stopped;
  }

  std::int64_t left_inside() const {
    std::int64_t inside = 0;
    const std::size_t steps = plan_.cells * plan_.substeps;
    for (std::size_t p = 1; p < plan_.points; ++p) {
      unsigned deep = 0;
      for (std::size_t k = 0; k < near_; ++k) {
        const std::size_t c = b_.near[k];
        if (b_.dues[p * plan_.colliders + c] > b_.shift[p]) continue;
        const std::size_t row = (steps - 1) * plan_.colliders + c;
        const N off = sample(row, c, true, at(b_.x, p)).distance - depths(p, c);
        deep |= bits(below(off, N(-plan_.tolerance)));
      }
      inside += count(deep);
    }
    return inside;
  }

  double longest() const {
    N most_of_all(0.0);
    for (std::size_t p = 1; p < plan_.points; ++p) {
      const V d = at(b_.x, p) - at(b_.x, p - 1);
      const N rest = N::of(b_.rests + WIDE * (p - 1));
      const N beyond = root(dot(d, d)) * inverse(rest) - 1.0;
      most_of_all = most(beyond, most_of_all);
    }
    return largest(most_of_all);
  }

  static constexpr double NEVER = 1e300;
  static constexpr unsigned ALL = 15;

  const StrandSteps& plan_;
  StrandBundle& b_;
  // Of the cell under way: where the animation has the strands at its begin, then at its
  // end; shares of it at the begin and the end of the step.
  const double* first_ = nullptr;
  double was_ = 0, is_ = 0;
  // How many colliders are near, and at which way any of the others may be met.
  std::size_t near_ = 0;
  double far_ = 0;
  // Which strands colliders may move.
  N allowed_{0.0};
  unsigned allowed_bits_ = 0;
};

template <class On>
void cross_bundle(const StrandSteps& plan, StrandBundle& bundle) {
  BundleCrossing<On>(plan, bundle).cross();
}

}  // namespace animtool
