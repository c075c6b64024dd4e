#include "export/map_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/box_room.h"

namespace iris::exporters {
namespace {

using mapping::MapRaster;
using mapping::MapState;
namespace fs = std::filesystem;

class MapFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() /
              ("iris_map_file_" + std::string(::testing::UnitTest::GetInstance()->current_test_info()->name()));
    fs::remove_all(folder_);
    raster_.cell = 0.05;
    raster_.origin_x = -12.350000000000001;
    raster_.origin_y = 1.0 / 3;
    raster_.width = 7, raster_.height = 5;
    raster_.layer_bounds = {-1, 0, 1};
    raster_.M = raster_.U = cv::Mat1f::zeros(5, 7);
    raster_.U = cv::Mat1f::zeros(5, 7);
    raster_.state = cv::Mat1b::zeros(5, 7);
    raster_.known = cv::Mat1b::zeros(5, 7);
    for (int k = 0; k < 2; ++k)
      raster_.layer_M.push_back(cv::Mat1f::zeros(5, 7)), raster_.layer_U.push_back(cv::Mat1f::zeros(5, 7));
    for (int y = 0; y < 5; ++y) {
      for (int x = 0; x < 7; ++x) {
        const int state = (3 * x + 5 * y + x * y) % 3;
        raster_.state(y, x) = static_cast<uint8_t>(state);
        raster_.known(y, x) = state != 0;
        if (state == 2) raster_.U(y, x) = raster_.layer_U[static_cast<size_t>(x % 2)](y, x) = 0.9f;
      }
    }
    for (int i = 0; i < 3; ++i) {
      PoseNode node{.frame_idx = i};
      node.world_from_cam.translation() << -12.3 + 0.1 * i, 0.4 + 0.05 * i, 0;
      graph_.nodes.push_back(node);
    }
  }
  void TearDown() override { fs::remove_all(folder_); }

  fs::path folder_;
  MapRaster raster_;
  PoseGraph graph_;
};

struct Nav2Map {
  std::string mode;
  double resolution = 0, x = 0, y = 0;
  cv::Mat1i cells;  // row 0 = largest y, as in the picture
};

// What nav2_map_server's loader does, with its comparisons and types; `ros1`: what map_server of ROS 1 does instead.
Nav2Map load_like_nav2(const fs::path& yaml, bool ros1 = false) {
  std::map<std::string, std::string> keys;
  std::ifstream file(yaml);
  for (std::string line; std::getline(file, line);) {
    const size_t colon = line.find(": ");
    if (!line.starts_with("#")) keys[line.substr(0, colon)] = line.substr(colon + 2);
  }
  Nav2Map map{.mode = keys.at("mode"), .resolution = std::stod(keys.at("resolution")), .cells = {}};
  double yaw = 1;
  EXPECT_EQ(std::sscanf(keys.at("origin").c_str(), "[%lf, %lf, %lf]", &map.x, &map.y, &yaw), 3);
  EXPECT_EQ(yaw, 0);
  const double occupied = std::stod(keys.at("occupied_thresh")), free = std::stod(keys.at("free_thresh"));
  const bool negate = keys.at("negate") != "0";
  const cv::Mat image = cv::imread((yaml.parent_path() / keys.at("image")).string(), cv::IMREAD_UNCHANGED);
  EXPECT_EQ(image.type(), map.mode == "scale" ? CV_8UC4 : CV_8UC1);
  map.cells.create(image.rows, image.cols);
  for (int row = 0; row < image.rows; ++row) {
    for (int column = 0; column < image.cols; ++column) {
      const uint8_t* pixel = image.ptr(row, column);
      const bool opaque = image.channels() < 4 || pixel[3] == 255;
      const double shade = image.channels() < 4 ? pixel[0] / 255.0 : (pixel[0] + pixel[1] + pixel[2]) / 3.0 / 255.0;
      const double occupancy = negate ? shade : 1.0 - shade;
      int value = occupied < occupancy ? 100 : occupancy < free ? 0 : -1;
      if (map.mode == "scale" && ros1) {
        if (value < 0 && opaque) value = static_cast<int>(1 + 98 * (occupancy - free) / (occupied - free));
      } else if (map.mode == "scale") {
        if (!opaque)
          value = -1;
        else if (value < 0)
          value = static_cast<int>(std::rint((occupancy - free) / (occupied - free) * 100));
      }
      map.cells(row, column) = value;
    }
  }
  return map;
}

void expect_the_same_states(const cv::Mat1i& cells, const MapRaster& raster) {
  ASSERT_EQ(cells.size(), raster.state.size());
  for (int row = 0; row < cells.rows; ++row) {
    for (int column = 0; column < cells.cols; ++column) {
      const int value = cells(row, column);
      const MapState state = value < 0 ? MapState::unknown : value == 100 ? MapState::occupied : MapState::free;
      EXPECT_EQ(static_cast<uint8_t>(state), raster.state(row, column)) << value << " at " << row << ", " << column;
    }
  }
}

TEST_F(MapFileTest, Nav2ReloadsOccupiedFreeAndUnknownAsTheyWere) {
  write_map(folder_, raster_, {}, graph_, 0, {});
  const Nav2Map map = load_like_nav2(folder_ / "map.yaml");
  EXPECT_EQ(map.mode, "trinary");
  EXPECT_EQ(map.resolution, raster_.cell);
  EXPECT_EQ(map.x, raster_.origin_x);  // bit for bit
  EXPECT_EQ(map.y, raster_.origin_y);
  expect_the_same_states(map.cells, raster_);
  EXPECT_TRUE(std::all_of(map.cells.begin(), map.cells.end(), [](int v) { return v == -1 || v == 0 || v == 100; }));
  // Unknown is the shade that cost maps know as such.
  const cv::Mat1b image = cv::imread((folder_ / "map.pgm").string(), cv::IMREAD_UNCHANGED);
  cv::Mat1b unknown = raster_.state == static_cast<uint8_t>(MapState::unknown);
  EXPECT_EQ(cv::countNonZero((image == 205) != unknown), 0);
}

TEST_F(MapFileTest, ScaleModeKeepsTheStatesAndTellsHowUnsafeFreeCellsAre) {
  // All that memberships allow: free cells are less than half unsafe, occupied ones at least by 0.35.
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 7; ++x) {
      const float part = static_cast<float>(7 * y + x) / 34;
      if (raster_.state(y, x) == 1) raster_.U(y, x) = 0.5f * part;
      if (raster_.state(y, x) == 2) raster_.U(y, x) = 0.35f + 0.65f * part;
    }
  }
  write_map(folder_, raster_, {}, graph_, 0, {.mode = "scale"});
  const Nav2Map map = load_like_nav2(folder_ / "map.yaml");
  EXPECT_EQ(map.mode, "scale");
  expect_the_same_states(map.cells, raster_);
  expect_the_same_states(load_like_nav2(folder_ / "map.yaml", true).cells, raster_);
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 7; ++x) {
      if (raster_.state(y, x) != 1) continue;
      // Linear up to the threshold of 0.65; half a grey level is 0.3, rounding 0.5, white's threshold 0.2.
      EXPECT_NEAR(map.cells(y, x), raster_.U(y, x) / 0.65 * 100, 1.0);
    }
  }
  // Back to the other mode: nothing is left of it.
  write_map(folder_, raster_, {}, graph_, 0, {});
  EXPECT_FALSE(fs::exists(folder_ / "map_scale.png"));
  expect_the_same_states(load_like_nav2(folder_ / "map.yaml").cells, raster_);
}

// A map of a room with a table: of each layer alone, the same cells as a map that has that layer only.
TEST_F(MapFileTest, LayersAreMapsOfTheirOwnInTheSamePlace) {
  const RectifiedCamera camera{.f = 100, .cx = 79.5, .cy = 59.5, .baseline = 0.3, .width = 160, .height = 120};
  // What could be seen past the obstacles of all layers is another matter.
  const mapping::FlogOptions options{.layers = 3, .bottom = -1.0, .height = 1.8, .seen_only = false};
  mapping::FlogBuilder all(options, camera);
  const mapping::FlogOptions of_middle{.layers = 1, .bottom = -0.4, .height = 0.6, .seen_only = false};
  mapping::FlogBuilder middle(of_middle, camera);
  for (const double yaw : {0.0, 1.6, 3.2, 4.8}) {
    const StereoView view = iris::testing::view_of({}, camera, iris::testing::level_camera({0, 0, 0}, yaw));
    all.add(view), middle.add(view);
  }
  const MapRaster whole = mapping::rasterise(all.map(), options);
  std::vector<MapRaster> layers;
  for (int k = 0; k < 3; ++k) layers.push_back(layer_raster(whole, k));
  // Taking a layer out leaves the whole map as it was.
  EXPECT_EQ(cv::countNonZero(whole.known), cv::countNonZero(whole.state));
  const MapRaster expected = mapping::rasterise(middle.map(), of_middle);
  EXPECT_GT(cv::countNonZero(expected.state == static_cast<uint8_t>(MapState::occupied)), 100);

  write_map(folder_, whole, layers, {}, 0, {});
  for (int k = 0; k < 3; ++k) {
    const Nav2Map map = load_like_nav2(folder_ / ("map_layer" + std::to_string(k) + ".yaml"));
    EXPECT_EQ(map.x, whole.origin_x);
    EXPECT_EQ(map.y, whole.origin_y);
    expect_the_same_states(map.cells, layers[static_cast<size_t>(k)]);
  }
  EXPECT_THAT(read_file(folder_ / "map_layer1.yaml"), ::testing::HasSubstr("between z = -0.4 m and 0.2 m"));
  // Cell by cell where both have one; beyond the smaller map there is nothing.
  const MapRaster& layer = layers[1];
  const int right = static_cast<int>(std::lround((expected.origin_x - whole.origin_x) / whole.cell));
  const int up = static_cast<int>(std::lround((expected.origin_y - whole.origin_y) / whole.cell));
  int different = 0, known = 0;
  for (int y = 0; y < expected.height; ++y) {
    for (int x = 0; x < expected.width; ++x) {
      different += layer.state(whole.height - up - expected.height + y, right + x) != expected.state(y, x);
      known += expected.state(y, x) != 0;
    }
  }
  EXPECT_EQ(different, 0);
  EXPECT_EQ(cv::countNonZero(layer.state), known);
  // Where any layer is occupied the map is; where all are unknown it is.
  for (int y = 0; y < whole.height; ++y) {
    for (int x = 0; x < whole.width; ++x) {
      EXPECT_EQ(whole.state(y, x), std::max({layers[0].state(y, x), layers[1].state(y, x), layers[2].state(y, x)}));
    }
  }
  // Without layers: the files of before are gone.
  write_map(folder_, whole, {}, {}, 0, {.layers = false});
  EXPECT_FALSE(fs::exists(folder_ / "map_layer0.yaml"));
  EXPECT_FALSE(fs::exists(folder_ / "map_layer0.pgm"));
}

TEST_F(MapFileTest, WorldFileGivesTheCentresOfThePixels) {
  write_map(folder_, raster_, {}, graph_, 0, {});
  std::istringstream file(read_file(folder_ / "map.pgw"));
  double a, d, b, e, c, f;  // the order of the format
  ASSERT_TRUE(file >> a >> d >> b >> e >> c >> f);
  for (const auto& [column, row] : {std::pair(0, 0), std::pair(6, 4), std::pair(3, 1)}) {
    EXPECT_NEAR(a * column + b * row + c, raster_.x_of(column), 1e-12);
    EXPECT_NEAR(d * column + e * row + f, raster_.y_of(row), 1e-12);
  }
  EXPECT_NEAR(raster_.y_of(4) - 0.025, raster_.origin_y, 1e-12);
  // A corner that is known: the wall of a room ends at x = 2.27 m, y = 1.61 m. The picture's pixel there lies, by the
  // world file, within half a cell.
  const RectifiedCamera camera{.f = 200, .cx = 159.5, .cy = 119.5, .baseline = 0.6, .width = 320, .height = 240};
  const mapping::FlogOptions options{.layers = 1, .bottom = -1.0, .height = 2};
  mapping::FlogBuilder builder(options, camera);
  for (const double yaw : {0.3, 0.62, 0.95}) {
    builder.add(iris::testing::view_of({}, camera, iris::testing::level_camera({yaw / 4, 0, 0}, yaw)));
  }
  const MapRaster room = mapping::rasterise(builder.map(), options);
  write_map(folder_, room, {}, {}, 0, {});
  std::istringstream of_room(read_file(folder_ / "map.pgw"));
  ASSERT_TRUE(of_room >> a >> d >> b >> e >> c >> f);
  const cv::Mat1b picture = cv::imread((folder_ / "map.pgm").string(), cv::IMREAD_UNCHANGED);
  // The walls: the middle of the columns, and of the rows, with most occupied pixels.
  const auto wall = [&](int dimension) {
    cv::Mat1i counts;
    cv::reduce(picture == 0, counts, dimension, cv::REDUCE_SUM, CV_32S);
    const int most = *std::max_element(counts.begin(), counts.end());
    double sum = 0, places = 0;
    for (int i = 0; i < static_cast<int>(counts.total()); ++i) {
      if (counts(i) >= 0.7 * most) sum += i, ++places;
    }
    return sum / places;
  };
  const double right = wall(0), upper = wall(1);
  EXPECT_NEAR(a * right + b * upper + c, 2.27, 0.5 * room.cell);
  EXPECT_NEAR(d * right + e * upper + f, 1.61, 0.5 * room.cell);
}

TEST_F(MapFileTest, PictureTellsUnknownFromFreeAndOccupied) {
  write_map(folder_, raster_, {}, graph_, 0, {});
  const cv::Mat3b picture = cv::imread((folder_ / "map.png").string());
  ASSERT_EQ(picture.size(), raster_.state.size());
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 7; ++x) {
      const cv::Vec3b colour = picture(y, x);
      const bool grey = colour[0] == colour[1] && colour[1] == colour[2];
      switch (static_cast<MapState>(raster_.state(y, x))) {
        case MapState::unknown:
          EXPECT_FALSE(grey);
          break;
        case MapState::free:
          EXPECT_EQ(colour, cv::Vec3b::all(255));
          break;
        case MapState::occupied:
          EXPECT_EQ(colour, cv::Vec3b::all(26));
          break;  // 255 (1 - 0.9), rounded
      }
    }
  }
}

TEST_F(MapFileTest, DecoratedPicturesShowPathStartAndEndOfTheSubmap) {
  PoseNode stray{.frame_idx = 9, .submap = 1};
  stray.world_from_cam.translation() << 500, 500, 0;
  graph_.nodes.push_back(stray);
  write_map(folder_, raster_, {}, graph_, 0, {});
  // The known cells are those of columns 0 to 6 and rows 1 to 4 from above; two cells around them, 16-fold, 64 px to
  // the left and 20 above.
  const double left = raster_.origin_x - 0.1, top = raster_.origin_y + 4 * 0.05 + 0.1;
  for (const char* name : {"map_picture.png", "layers.png"}) {
    const cv::Mat3b picture = cv::imread((folder_ / name).string());
    ASSERT_FALSE(picture.empty());
    const auto at = [&](const Eigen::Vector3d& p) {
      return picture(20 + static_cast<int>((top - p.y()) / 0.05 * 16),
                     64 + static_cast<int>((p.x() - left) / 0.05 * 16));
    };
    EXPECT_EQ(at(graph_.nodes[0].world_from_cam.translation()), cv::Vec3b(115, 158, 0)) << name;
    EXPECT_EQ(at(graph_.nodes[1].world_from_cam.translation()), cv::Vec3b(0, 94, 213)) << name;
    EXPECT_EQ(at(graph_.nodes[2].world_from_cam.translation()), cv::Vec3b(178, 114, 0)) << name;
  }
  // An end that lies on the start leaves a ring of it.
  graph_.nodes[2].world_from_cam = graph_.nodes[0].world_from_cam;
  write_map(folder_, raster_, {}, graph_, 0, {});
  const cv::Mat3b picture = cv::imread((folder_ / "map_picture.png").string());
  cv::Mat1b green, blue;
  cv::inRange(picture(cv::Rect(64, 20, 170, 120)), cv::Scalar(115, 158, 0), cv::Scalar(115, 158, 0), green);
  cv::inRange(picture(cv::Rect(64, 20, 170, 120)), cv::Scalar(178, 114, 0), cv::Scalar(178, 114, 0), blue);
  EXPECT_GT(cv::countNonZero(green), 5);
  EXPECT_GT(cv::countNonZero(blue), 10);
}

// Of unknown surroundings nothing is shown but a margin; small maps are enlarged, large ones are not larger than a
// screen needs.
TEST_F(MapFileTest, PicturesShowWhatIsKnown) {
  const auto size_of = [&](int width, int height, const cv::Rect& known) {
    raster_.width = width, raster_.height = height;
    raster_.U = cv::Mat1f::zeros(height, width);
    raster_.known = raster_.state = cv::Mat1b::zeros(height, width);
    raster_.known = raster_.state.clone();
    raster_.known(known) = 1, raster_.state(known) = 1;
    for (cv::Mat1f& layer : raster_.layer_U) layer = cv::Mat1f::zeros(height, width);
    write_map(folder_, raster_, {}, {}, 0, {});
    const cv::Size size = cv::imread((folder_ / "map_picture.png").string()).size();
    return cv::Size(size.width - 64 - 260, size.height - 20 - 78);
  };
  EXPECT_EQ(size_of(2000, 1000, {600, 300, 126, 76}), cv::Size(130 * 10, 80 * 10));
  EXPECT_EQ(size_of(1600, 1000, {0, 0, 1596, 996}), cv::Size(1600, 1000));
  EXPECT_EQ(size_of(9000, 3000, {0, 0, 8996, 2996}), cv::Size(3000, 1000));
}

TEST_F(MapFileTest, WritesTheSameBytesAgainAndWorksWithoutAPath) {
  write_map(folder_, raster_, {}, graph_, 0, {});
  std::map<std::string, std::string> first;
  for (const auto& entry : fs::directory_iterator(folder_)) first[entry.path().filename()] = read_file(entry.path());
  EXPECT_EQ(first.size(), 6u);
  write_map(folder_, raster_, {}, graph_, 0, {});
  for (const auto& [name, bytes] : first) EXPECT_EQ(read_file(folder_ / name), bytes) << name;
  write_map(folder_, raster_, {}, {}, 0, {});
}

TEST_F(MapFileTest, SaysThatTheFolderCannotBeWritten) {
  fs::create_directories(folder_);
  std::ofstream(folder_ / "file") << "in the way";
  EXPECT_THROW(write_map(folder_ / "file", raster_, {}, graph_, 0, {}), InputError);
}

}  // namespace
}  // namespace iris::exporters
