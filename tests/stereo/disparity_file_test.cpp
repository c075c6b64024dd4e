#include "iris/stereo/disparity_file.h"

#include <gmock/gmock.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <opencv2/imgcodecs.hpp>

#include "support/temporary_folder.h"

namespace iris::stereo {
namespace {

TEST(DisparityFile, KittiCodeIs256TimesTheDisparity) {
  const cv::Mat1f disparity = (cv::Mat1f(1, 4) << 0, 1.0f, 2.503f, 255.5f);
  const cv::Mat1w code = kitti_code(disparity);
  EXPECT_THAT(std::vector<int>(code.begin(), code.end()), ::testing::ElementsAre(0, 256, 641, 65408));
}

// OpenCV reads what is written.
TEST(DisparityFile, PfmIsReadByOpenCv) {
  const testing::TemporaryFolder folder;
  cv::Mat1f disparity(5, 7);
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 7; ++x) disparity(y, x) = 0.1f + static_cast<float>(10 * y) + 0.37f * static_cast<float>(x);
  }
  disparity(2, 3) = 0;
  const auto path = folder.path() / "d.pfm";
  std::ofstream(path, std::ios::binary) << encode_pfm(disparity);
  const cv::Mat1f read = cv::imread(path.string(), cv::IMREAD_UNCHANGED);
  ASSERT_EQ(read.size(), disparity.size());
  for (int y = 0; y < 5; ++y) {
    for (int x = 0; x < 7; ++x) {
      if (y == 2 && x == 3) {
        EXPECT_TRUE(std::isinf(read(y, x)));
      } else {
        EXPECT_EQ(read(y, x), disparity(y, x));
      }
    }
  }
}

// Depth = f b / (disparity + offset).
TEST(DisparityFile, DepthsAndPointsAreThoseOfTheCamera) {
  const RectifiedCamera camera{
      .f = 400, .cx = 1, .cy = 1, .baseline = 0.5, .disparity_offset = 2, .width = 3, .height = 2};
  DisparityImage image{(cv::Mat1f(2, 3) << 8, 0, 3, 18, 98, 38), (cv::Mat1b(2, 3) << 1, 0, 4, 1, 2, 3)};
  const cv::Mat1f depth = depth_image(image.disparity, camera);
  EXPECT_FLOAT_EQ(depth(0, 0), 20);
  EXPECT_EQ(depth(0, 1), 0);
  EXPECT_FLOAT_EQ(depth(0, 2), 40);
  EXPECT_FLOAT_EQ(depth(1, 2), 5);
  cv::Mat3b colour(2, 3, cv::Vec3b(10, 20, 30));
  const std::string ply = encode_ply(image, colour, camera, DisparityOrigin::within_segment);
  EXPECT_THAT(ply, ::testing::HasSubstr("element vertex 4\n"));
  const size_t begin = ply.find("end_header\n") + 11;
  ASSERT_EQ(ply.size() - begin, 4u * 15);
  float first[3];
  std::memcpy(first, ply.data() + begin, sizeof(first));
  EXPECT_FLOAT_EQ(first[0], -0.05f);  // (0 - 1) * 20 / 400
  EXPECT_FLOAT_EQ(first[1], -0.05f);
  EXPECT_FLOAT_EQ(first[2], 20);
  EXPECT_EQ(ply.substr(begin + 12, 3), std::string("\x1e\x14\x0a"));  // red green blue
}

}  // namespace
}  // namespace iris::stereo
