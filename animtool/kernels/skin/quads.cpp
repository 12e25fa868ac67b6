// Linear blend skinning for processors that have registers of four doubles.
#include "base/quads.h"
#include "skin/blend.h"

namespace animtool {

std::optional<BlendFunctions> blend_in_quads() {
  if (!has_quads()) return std::nullopt;
  return make_blend_functions<Four<Quads>, Quads>();
}

}  // namespace animtool
