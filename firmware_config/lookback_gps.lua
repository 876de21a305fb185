--[[
What ArduPilot does when Lookback finds GPS to be wrong, and when Lookback has ended in a set of sources without GPS.

Copy this file to APM/scripts on the autopilot's SD card, set SCR_ENABLE 1, and reboot. Works on ArduPilot 4.5 and newer,
also where `[gates] doubted_gps = "report"`: Lookback sends NAMED_VALUE_FLOAT gps_doubt once a second, from 0 (consistent) to
1 (faulty), or -1 where it cannot say.

LKG_ACTION   0: a line of text only (the default). 1: select the second set of sources (EK3_SRC2_...), and the first set
             again when GPS is consistent. 2: RTL. 3: both. RTL alone goes where a wrong GPS leads it.
LKG_COUNT    so many values of 1 in a row are needed, and so many of at most 0.2 to go back.
LKG_COMPID   component ID of Lookback ([telemetry] component_id), on this vehicle's own system

Where Lookback (or this script) selected the second set and neither heartbeats nor poses of Lookback have come for 10 s, the
first set is selected again, whatever LKG_ACTION is, once the receiver has had a 3-D fix of 10 m or better for 10 s.
A set that the pilot has selected stays. Nor is anything changed where GPS was doubted (above 0.2) when Lookback spoke last: the
pilot gets a line each 30 s, and may select the first set (RCx_OPTION 90) or another mode.
--]]

local PARAM_TABLE_KEY = 187
local HEARTBEAT, COMMAND_LONG, VISION_POSITION_ESTIMATE, NAMED_VALUE_FLOAT = 0, 76, 102, 251
local NAME = "gps_doubt"
local SELECTS_SET = 42007 -- MAV_CMD_SET_EKF_SOURCE_SET, which counts from 1
local FIRST_SET, SECOND_SET = 0, 1
local FIX_3D, GOOD_M = 3, 10
local RTL_MODES = { [1] = 11, [2] = 6, [3] = 11 } -- by FWVersion:type(): Rover, Copter, Plane
local WARNING, NOTICE = 4, 5
local PERIOD_MS = 200
local SILENT_TICKS, SAID_TICKS = 50, 150 -- 10 s without a message, which come once a second; 30 s between two lines

assert(param:add_table(PARAM_TABLE_KEY, "LKG_", 3), "lookback_gps: no room for parameters")
assert(param:add_param(PARAM_TABLE_KEY, 1, "ACTION", 0), "lookback_gps: LKG_ACTION")
assert(param:add_param(PARAM_TABLE_KEY, 2, "COUNT", 3), "lookback_gps: LKG_COUNT")
assert(param:add_param(PARAM_TABLE_KEY, 3, "COMPID", 191), "lookback_gps: LKG_COMPID")

-- Both numbers alike: their order differs between versions of the documentation.
mavlink:init(10, 10)
for _, id in ipairs({ HEARTBEAT, COMMAND_LONG, VISION_POSITION_ESTIMATE, NAMED_VALUE_FLOAT }) do
  mavlink:register_rx_msgid(id)
end

local system_id = param:get("MAV_SYSID") or param:get("SYSID_THISMAV")
local wrong, right, doubted = 0, 0, false
local acted, selected = false, false -- whether this script did; whether it or Lookback selected the second set last
local tick, heard_tick, said_tick, bad_gps_tick = 0, 0, -SAID_TICKS, 0

-- Whether a message is of Lookback, which it then reads. The string is ArduPilot's mavlink_message_t, whose header grew
-- when system IDs of 32 bits came; a payload is followed by zeros where the sender cut them off.
local function read(message)
  local system, component, id, at = string.unpack(#message >= 299 and "<I4BI3" or "<BBI3", message, 8)
  if system ~= system_id or component ~= param:get("LKG_COMPID") then
    return
  end
  heard_tick = tick
  if id == NAMED_VALUE_FLOAT then
    local _, doubt, name = string.unpack("<I4fc10", message, at)
    if string.match(name, "^[^\0]*") == NAME then
      wrong = doubt >= 1 and wrong + 1 or 0
      right = (doubt >= 0 and doubt <= 0.2) and right + 1 or 0
      doubted = doubt > 0.2 or (doubt < 0 and doubted) -- not known is not agreed
    end
  elseif id == COMMAND_LONG then
    local number, _, _, _, _, _, _, command = string.unpack("<fffffffI2", message, at)
    selected = command == SELECTS_SET and number == SECOND_SET + 1 or (command ~= SELECTS_SET and selected)
  end
end

local function act()
  local action = param:get("LKG_ACTION")
  acted = true
  if action == 1 or action == 3 then
    selected = true
    ahrs:set_posvelyaw_source_set(SECOND_SET)
    gcs:send_text(WARNING, "GPS faulty: source set 2")
  end
  if action == 2 or action == 3 then
    vehicle:set_mode(RTL_MODES[FWVersion:type()])
    gcs:send_text(WARNING, "GPS faulty: RTL")
  end
  if action == 0 then
    gcs:send_text(WARNING, "GPS faulty: no action (LKG_ACTION)")
  end
end

local function go_back()
  local action = param:get("LKG_ACTION")
  acted = false
  if action == 1 or action == 3 then
    selected = false
    ahrs:set_posvelyaw_source_set(FIRST_SET)
    gcs:send_text(NOTICE, "GPS consistent: source set 1")
  end
end

local function is_gps_good()
  local receiver = gps:primary_sensor()
  return gps:status(receiver) >= FIX_3D and (gps:horizontal_accuracy(receiver) or 0) <= GOOD_M
end

local function end_for_lookback()
  if tick - heard_tick <= SILENT_TICKS then
    return
  end
  if doubted then
    if (acted or selected) and tick - said_tick > SAID_TICKS then
      said_tick = tick
      gcs:send_text(WARNING, "Lookback is silent, GPS was doubted")
    end
  elseif selected and tick - bad_gps_tick > SILENT_TICKS then
    selected, acted = false, false
    if ahrs:get_posvelyaw_source_set() == SECOND_SET then -- else the pilot has selected another one
      ahrs:set_posvelyaw_source_set(FIRST_SET)
      gcs:send_text(WARNING, "Lookback ended: GPS, source set 1")
    end
  end
end

local function update()
  tick = tick + 1
  if not is_gps_good() then
    bad_gps_tick = tick
  end
  local message = mavlink:receive_chan()
  while message do
    read(message)
    message = mavlink:receive_chan()
  end
  local count = param:get("LKG_COUNT")
  if not acted and wrong >= count then
    act()
  elseif acted and right >= count then
    go_back()
  end
  end_for_lookback()
  return update, PERIOD_MS
end

return update()
