// Self-contact pairs of one kind over the steps of a run.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "springs/separation.h"
#include "springs/tangles.h"

namespace animtool {

// A piercing pair, and the side (1 or -1) that the first came from.
struct Piercing {
  std::int32_t first, second, side;

  bool operator<(const Piercing& other) const {
    return std::pair(first, second) < std::pair(other.first, other.second);
  }
};

// Kind: TrianglesAndCorners or EdgesAndEdges. Neighbour lists only save time: contacts of a
// step do not depend on when the lists were built.
template <class Kind>
class LayerContacts {
 public:
  using Shape = typename Kind::Shape;

  std::vector<Piercing> crossed;
  void sort_crossed() { std::sort(crossed.begin(), crossed.end()); }

  // Lists all pairs within a reach; and picks those that may be nearer now, given the displacements
  // of particles since.
  void list(const SpringLayers& layers, const std::vector<double>& x, double reach) {
    listed_ = Kind::near(layers, x, reach);
  }
  void pick(const SpringLayers& layers, const std::vector<double>& x,
            const std::vector<double>& displacements, double reach);

  // Finds contacts in a step: `most` is the largest tested relative displacement, `more` the extra
  // distance of pairs that only return. Tangled pairs have no known side, and are skipped.
  void find(const SpringLayers& layers, const std::vector<double>& before,
            const std::vector<double>& x, double most, double more, const Tangles* tangles);
  void forget() { hits_.clear(); }
  bool any() const { return !hits_.empty(); }
  void separate(const SpringLayers& layers, Separation& separation) const;
  // Adds the picked pairs with a marked particle that passed through each other since the start of
  // the step.
  void collect_passed(const SpringLayers& layers, const std::vector<double>& from,
                      const std::vector<double>& x, const std::vector<std::uint8_t>& moved,
                      const Tangles& tangles, std::vector<LayerHit>& passed) const;
  // Drops piercing pairs that are back on their side, or moved away.
  void drop_resolved(const SpringLayers& layers, const std::vector<double>& x);
  // Records pairs that changed sides since the start of the step.
  void record_crossings(const std::vector<double>& before, const std::vector<double>& x);

 private:
  // The largest relative displacement of the elements.
  static double relative_shift(const FourParticles& who, const std::vector<double>& before,
                               const std::vector<double>& x);
  std::int32_t side_of(const LayerHit& hit, const std::vector<double>& before,
                       const std::vector<double>& x) const;
  static bool is_through(std::int32_t side, const Shape& now) {
    return side * now.height() < 0 && now.nearest().inside;
  }
  bool is_next_to_crossed(const SpringLayers& layers, const LayerHit& hit) const;

  std::vector<LayerPair> listed_, picked_;
  std::vector<LayerHit> hits_;
  Through through_;
};

template <class Kind>
void LayerContacts<Kind>::pick(const SpringLayers& layers, const std::vector<double>& x,
                               const std::vector<double>& displacements, double reach) {
  const auto most = [&](const std::int32_t* first, const std::int32_t* last) {
    double far = 0;
    for (; first != last; ++first)
      far = std::max(far, displacements[static_cast<std::size_t>(*first)]);
    return far;
  };
  picked_.clear();
  for (const LayerPair& one : listed_) {
    const FourParticles who = Kind::who(layers, one.first, one.second);
    const double nearer =
        most(&who[0], &who[Kind::FIRST]) + most(&who[Kind::FIRST], who.data() + 4);
    if (one.gap - nearer - one.distance > reach) continue;
    if (length(Shape(who.data(), x.data()).nearest().off) - one.distance <= reach)
      picked_.push_back(one);
  }
}

template <class Kind>
void LayerContacts<Kind>::find(const SpringLayers& layers, const std::vector<double>& before,
                               const std::vector<double>& x, double most, double more,
                               const Tangles* tangles) {
  const auto tangled = [&](const std::int32_t* first, const std::int32_t* last) {
    return std::all_of(first, last, [&](std::int32_t n) { return tangles->has(n); });
  };
  hits_.clear();
  through_.clear();
  for (const LayerPair& one : picked_) {
    const FourParticles who = Kind::who(layers, one.first, one.second);
    const shapes::Nearest near = Shape(who.data(), x.data()).nearest();
    const double gap = length(near.off);
    if (!(gap < one.distance + most + more)) continue;
    const double travel = relative_shift(who, before, x);
    if (!(gap < one.distance + travel + more)) continue;
    LayerHit hit{one.first, one.second, 0, who, gap, travel, one.distance};
    hit.side = side_of(hit, before, x);
    if (!hit.side && !near.inside) continue;
    if (tangles && !hit.side && tangled(&who[0], &who[Kind::FIRST]) &&
        tangled(&who[Kind::FIRST], who.data() + who.size()))
      continue;
    hits_.push_back(hit);
    if (hit.side) Kind::note(through_, hit.first, hit.second);
  }
  std::sort(through_.begin(), through_.end());
}

template <class Kind>
double LayerContacts<Kind>::relative_shift(const FourParticles& who,
                                           const std::vector<double>& before,
                                           const std::vector<double>& x) {
  collide::Vec shifts[4];
  for (std::size_t k = 0; k < 4; ++k)
    shifts[k] = shapes::row_of(x.data(), who[k]) - shapes::row_of(before.data(), who[k]);
  double most = 0;
  for (std::size_t i = 0; i < Kind::FIRST; ++i)
    for (std::size_t j = Kind::FIRST; j < 4; ++j) {
      const collide::Vec over = shifts[i] - shifts[j];
      most = std::max(most, dot(over, over));
    }
  return std::sqrt(most);
}

template <class Kind>
std::int32_t LayerContacts<Kind>::side_of(const LayerHit& hit, const std::vector<double>& before,
                                          const std::vector<double>& x) const {
  const auto known =
      std::lower_bound(crossed.begin(), crossed.end(), Piercing{hit.first, hit.second, 0});
  if (known != crossed.end() && known->first == hit.first && known->second == hit.second)
    return known->side;
  if (hit.gap > hit.travel) return 0;
  return shapes::crossed_from(Shape(hit.who.data(), before.data()),
                              Shape(hit.who.data(), x.data()));
}

// Whether one of them is on the wrong side of a neighbour of the other, so that its side of the
// other means nothing.
template <class Kind>
bool LayerContacts<Kind>::is_next_to_crossed(const SpringLayers& layers,
                                             const LayerHit& hit) const {
  const auto is_through = [&](std::int32_t who, const auto& touches) {
    auto one = std::lower_bound(through_.begin(), through_.end(), std::pair(who, -1));
    for (; one != through_.end() && one->first == who; ++one)
      if (touches(one->second)) return true;
    return false;
  };
  return Kind::is_next_to_crossed(layers, hit.first, hit.second, is_through);
}

template <class Kind>
void LayerContacts<Kind>::separate(const SpringLayers& layers, Separation& separation) const {
  for (const LayerHit& hit : hits_)
    if (hit.side || through_.empty() || !is_next_to_crossed(layers, hit))
      separation.separate<Shape>(hit);
}

template <class Kind>
void LayerContacts<Kind>::collect_passed(const SpringLayers& layers,
                                         const std::vector<double>& from,
                                         const std::vector<double>& x,
                                         const std::vector<std::uint8_t>& moved,
                                         const Tangles& tangles,
                                         std::vector<LayerHit>& passed) const {
  const auto tangled = [&](const std::int32_t* first, const std::int32_t* last) {
    return std::all_of(first, last, [&](std::int32_t n) { return tangles.has(n); });
  };
  for (const LayerPair& one : picked_) {
    const FourParticles who = Kind::who(layers, one.first, one.second);
    if (std::none_of(who.begin(), who.end(),
                     [&](std::int32_t n) { return moved[static_cast<std::size_t>(n)]; }))
      continue;
    if (!shapes::paths_overlap(who.data(), Kind::FIRST, from.data(), x.data())) continue;
    const std::int32_t side =
        shapes::passed_from(Shape(who.data(), from.data()), Shape(who.data(), x.data()));
    if (!side) continue;
    // Tangled pairs have no known side.
    if (tangled(&who[0], &who[Kind::FIRST]) && tangled(&who[Kind::FIRST], who.data() + 4)) continue;
    passed.push_back({one.first, one.second, side, who, 0, 0, one.distance});
  }
}

template <class Kind>
void LayerContacts<Kind>::drop_resolved(const SpringLayers& layers, const std::vector<double>& x) {
  std::erase_if(crossed, [&](const Piercing& one) {
    const Shape now(Kind::who(layers, one.first, one.second).data(), x.data());
    return !is_through(one.side, now);
  });
}

template <class Kind>
void LayerContacts<Kind>::record_crossings(const std::vector<double>& before,
                                           const std::vector<double>& x) {
  crossed.clear();
  for (const LayerHit& hit : hits_) {
    if (!hit.side && hit.gap > 2 * hit.travel) continue;
    const Shape now(hit.who.data(), x.data());
    std::int32_t side = hit.side;
    if (side) {
      if (!is_through(side, now)) side = 0;
    } else {
      side = shapes::crossed_from(Shape(hit.who.data(), before.data()), now);
    }
    if (side) crossed.push_back({hit.first, hit.second, side});
  }
}

}  // namespace animtool
