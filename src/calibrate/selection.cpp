// Which of many images of a target are worth using.
#include <algorithm>
#include <map>
#include <tuple>

#include "iris/calibrate/stereo.h"
#include "iris/core/median.h"

namespace iris::calibrate {
namespace {

// Mean distance [px] between the corners that both show; infinite if they are different ones.
double change(const Corners& a, const Corners& b) {
  if (a.empty() && b.empty()) return 0;
  std::map<int, Eigen::Vector2d> other;
  for (size_t i = 0; i < b.size(); ++i) other[b.ids[i]] = b.points[i];
  double sum = 0;
  size_t count = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    const auto partner = other.find(a.ids[i]);
    if (partner == other.end()) continue;
    sum += (partner->second - a.points[i]).norm();
    ++count;
  }
  if (2 * count <= std::max(a.size(), b.size())) return 1e9;
  return sum / static_cast<double>(count);
}

double change(const TargetView& a, const TargetView& b) {
  return std::max(change(a.left, b.left), change(a.right, b.right));
}

}  // namespace

ViewSelection select_views(std::vector<TargetView> views, const CalibrateOptions& options) {
  ViewSelection selection;
  std::vector<double> blurs;
  for (const TargetView& view : views) {
    if (!view.left.empty()) blurs.push_back(view.left_blur);
    if (!view.right.empty()) blurs.push_back(view.right_blur);
  }
  const double limit = blurs.empty() ? 0 : options.max_blur * median(blurs);
  for (TargetView& view : views) {
    if (view.left.empty() && view.right.empty()) {
      ++selection.unseen;
      continue;
    }
    if ((!view.left.empty() && view.left_blur > limit) || (!view.right.empty() && view.right_blur > limit)) {
      ++selection.blurred;
      continue;
    }
    const bool known = std::any_of(selection.views.begin(), selection.views.end(),
                                   [&](const TargetView& other) { return change(view, other) < options.min_change; });
    if (known) {
      ++selection.duplicates;
      continue;
    }
    selection.views.push_back(std::move(view));
  }
  // The one that is nearest to another goes first, until few enough are left; views of one camera before pairs.
  while (static_cast<int>(selection.views.size()) > options.max_pairs) {
    const size_t n = selection.views.size();
    size_t worst = 0;
    std::tuple<bool, double> least{true, 1e300};
    for (size_t i = 0; i < n; ++i) {
      double nearest = 1e300;
      for (size_t k = 0; k < n; ++k) {
        if (k != i) nearest = std::min(nearest, change(selection.views[i], selection.views[k]));
      }
      const std::tuple<bool, double> value{selection.views[i].is_pair(), nearest};
      if (value < least) {
        least = value;
        worst = i;
      }
    }
    selection.views.erase(selection.views.begin() + static_cast<std::ptrdiff_t>(worst));
    ++selection.surplus;
  }
  return selection;
}

}  // namespace iris::calibrate
