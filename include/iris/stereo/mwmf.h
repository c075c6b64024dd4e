// MWMF stereo: dense disparities from a rectified pair by correlation over multiple windows, with several filters that
// reject wrong matches (thesis chapter 3).
#pragma once

#include <opencv2/core.hpp>
#include <string>

#include "iris/core/options.h"
#include "iris/types/disparity_image.h"

namespace iris::stereo {

struct MwmfOptions {
  std::string preset = "default";            // thesis | default | quality: values of all options below the first group
  int disparities = 0;                       // [px] search range, 0 = found from the recording (estimate_search_range)
  int min_disparity = 0;                     // [px] start of the search range; negative if the cameras squint
  std::string interpolation = "everywhere";  // off | within | everywhere (3.4.5)

  std::string method = "mwmf";  // mwmf | sgbm: OpenCV's semi-global matching instead of correlation
  std::string measure = "sad";  // sad | census_sad | census | rank | ssd | ncc (3.4.2)
  int windows = 5;              // 1 | 5 | 9 | 25: windows that support each other (3.1-3.3)
  int window_width = 7;         // [px] of each of them; odd (an even number is raised by one)
  int window_height = 7;        // [px]
  double log_sigma = 1.0;       // [px] Laplacian of Gaussian on the grey values (3.4.1); 0 = off
  double difference_cap = 3.0;  // [grey levels] most that one pixel's difference counts; 0 = no cap of its own
  bool cut_windows = true;      // windows may reach beyond the images; else no disparities next to their edges

  double min_margin = 0.08;              // [grey levels per window pixel] smallest margin of the winner (3.4); 0 = off
  double left_right_tolerance = 1.0;     // [px] largest difference between both search directions (3.4.1); < 0 = off
  bool reject_outermost = true;          // drops matches with the outermost columns of the right image
  std::string sub_pixel = "equalised";   // off | parabola | v | equalised (3.4.1)
  std::string borders = "support";       // off | halves | support: correction of the borders of objects (3.4.4)
  int border_reach = 4;                  // [px] by how much a border may be moved
  int border_rows = 5;                   // rows that take part in it; odd
  int min_segment = 80;                  // [px] smaller segments are errors (3.4.1); 0 = off
  double segment_tolerance = 1.0;        // [px] step of disparity that separates segments
  std::string gaps = "second_smallest";  // smallest | second_smallest of the neighbours fills gaps between segments
  std::string extrapolation = "parallel";  // parallel | plane: how a surface goes on in large gaps (ch. 10)
  bool left_from_right = true;             // the strip at the left edge continues its right neighbour
  bool hidden_strips = true;               // strips hidden by an object continue their left neighbour
  std::string median = "guided";           // off | plain | guided: median at the end

  void declare(OptionSet& set);

  // Sets everything from `method` on to what `preset` stands for:
  //   thesis   the method as the thesis describes it;
  //   default  the same steps, with what measurements have shown to be better;
  //   quality  census bits beside the grey values: fewer errors, slower.
  void apply_preset();
};

// Disparities of the left image: x_right = x_left - disparity. Both images have the same size and corresponding rows.
// Requires options.disparities > 0. Independent of the number of threads and of the instruction set, bit for bit.
//
// origin says whether a disparity was measured, moved with the border of an object, or interpolated; none = 0. A point
// that is measured at disparity 0 or less (infinitely far, or beyond with a camera that squints) gets
// kSmallestDisparity, because 0 means none.
DisparityImage mwmf(const cv::Mat1b& left, const cv::Mat1b& right, const MwmfOptions& options);

inline constexpr float kSmallestDisparity = 1.0f / 16;  // [px]

}  // namespace iris::stereo
