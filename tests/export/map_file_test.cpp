#include "export/map_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <opencv2/imgcodecs.hpp>
#include <sstream>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"

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

// What nav2_map_server's loader does in trinary mode, with its comparisons and types.
std::vector<int> load_like_nav2(const fs::path& yaml, double& resolution, double& x, double& y) {
  std::map<std::string, std::string> keys;
  std::ifstream file(yaml);
  for (std::string line; std::getline(file, line);) {
    const size_t colon = line.find(": ");
    keys[line.substr(0, colon)] = line.substr(colon + 2);
  }
  EXPECT_EQ(keys.at("mode"), "trinary");
  resolution = std::stod(keys.at("resolution"));
  double yaw = 1;
  EXPECT_EQ(std::sscanf(keys.at("origin").c_str(), "[%lf, %lf, %lf]", &x, &y, &yaw), 3);
  EXPECT_EQ(yaw, 0);
  const double occupied = std::stod(keys.at("occupied_thresh")), free = std::stod(keys.at("free_thresh"));
  const bool negate = keys.at("negate") != "0";
  const cv::Mat image = cv::imread((yaml.parent_path() / keys.at("image")).string(), cv::IMREAD_UNCHANGED);
  EXPECT_EQ(image.type(), CV_8UC1);
  std::vector<int> cells(image.total());  // row 0 of the grid = smallest y
  for (int row = 0; row < image.rows; ++row) {
    for (int column = 0; column < image.cols; ++column) {
      const double shade = image.at<uint8_t>(row, column) / 255.0;
      const double occupancy = negate ? shade : 1.0 - shade;
      const int value = occupied < occupancy ? 100 : occupancy < free ? 0 : -1;
      cells[static_cast<size_t>((image.rows - row - 1) * image.cols + column)] = value;
    }
  }
  return cells;
}

TEST_F(MapFileTest, Nav2ReloadsOccupiedFreeAndUnknownAsTheyWere) {
  write_map(folder_, raster_, graph_);
  double resolution = 0, x = 0, y = 0;
  const std::vector<int> cells = load_like_nav2(folder_ / "map.yaml", resolution, x, y);
  EXPECT_EQ(resolution, raster_.cell);
  EXPECT_EQ(x, raster_.origin_x);  // bit for bit
  EXPECT_EQ(y, raster_.origin_y);
  ASSERT_EQ(cells.size(), 35u);
  for (int row = 0; row < 5; ++row) {
    for (int column = 0; column < 7; ++column) {
      const int expected = std::array{-1, 0, 100}.at(raster_.state(row, column));
      EXPECT_EQ(cells[static_cast<size_t>((4 - row) * 7 + column)], expected);
    }
  }
}

TEST_F(MapFileTest, WorldFileGivesTheCentresOfThePixels) {
  write_map(folder_, raster_, graph_);
  std::istringstream file(read_file(folder_ / "map.pgw"));
  double a, d, b, e, c, f;  // the order of the format
  ASSERT_TRUE(file >> a >> d >> b >> e >> c >> f);
  for (const auto& [column, row] : {std::pair(0, 0), std::pair(6, 4), std::pair(3, 1)}) {
    EXPECT_NEAR(a * column + b * row + c, raster_.x_of(column), 1e-12);
    EXPECT_NEAR(d * column + e * row + f, raster_.y_of(row), 1e-12);
  }
  EXPECT_NEAR(raster_.y_of(4) - 0.025, raster_.origin_y, 1e-12);
}

TEST_F(MapFileTest, PictureTellsUnknownFromFreeAndOccupied) {
  write_map(folder_, raster_, graph_);
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
  write_map(folder_, raster_, graph_);
  for (const char* name : {"map_picture.png", "layers.png"}) {
    const cv::Mat3b picture = cv::imread((folder_ / name).string());
    ASSERT_FALSE(picture.empty());
    // 16-fold, 60 px to the left and 34 above: the path's start is at cell (1.0, 1.33) from below.
    const auto at = [&](const Eigen::Vector3d& p) {
      return picture(34 + static_cast<int>(80 - (p.y() - raster_.origin_y) / 0.05 * 16),
                     60 + static_cast<int>((p.x() - raster_.origin_x) / 0.05 * 16));
    };
    EXPECT_EQ(at(graph_.nodes[0].world_from_cam.translation()), cv::Vec3b(115, 158, 0));
    EXPECT_EQ(at(graph_.nodes[1].world_from_cam.translation()), cv::Vec3b(0, 94, 213));
    EXPECT_EQ(at(graph_.nodes[2].world_from_cam.translation()), cv::Vec3b(178, 114, 0));
  }
}

TEST_F(MapFileTest, WritesTheSameBytesAgainAndWorksWithoutAPath) {
  write_map(folder_, raster_, graph_);
  std::map<std::string, std::string> first;
  for (const auto& entry : fs::directory_iterator(folder_)) first[entry.path().filename()] = read_file(entry.path());
  EXPECT_EQ(first.size(), 6u);
  write_map(folder_, raster_, graph_);
  for (const auto& [name, bytes] : first) EXPECT_EQ(read_file(folder_ / name), bytes) << name;
  write_map(folder_, raster_, {});
}

TEST_F(MapFileTest, SaysThatTheFolderCannotBeWritten) {
  fs::create_directories(folder_);
  std::ofstream(folder_ / "file") << "in the way";
  EXPECT_THROW(write_map(folder_ / "file", raster_, graph_), InputError);
}

}  // namespace
}  // namespace iris::exporters
