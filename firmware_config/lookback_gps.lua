--[[
What ArduPilot does when Lookback finds GPS to be wrong.

Copy this file to APM/scripts on the autopilot's SD card, set SCR_ENABLE 1, and reboot. Works on ArduPilot 4.5 and newer,
also where `[gates] doubted_gps = "report"`: Lookback sends NAMED_VALUE_FLOAT gps_doubt once a second, from 0 (consistent) to
1 (faulty), or -1 where it cannot say.

LKG_ACTION   0: a line of text only (the default). 1: select the second set of sources (EK3_SRC2_...), and the first set
             again when GPS is consistent. 2: RTL. 3: both. RTL alone goes where a wrong GPS leads it.
LKG_COUNT    so many values of 1 in a row are needed, and so many of at most 0.2 to go back.
LKG_COMPID   component ID of Lookback ([telemetry] component_id), on this vehicle's own system

A Lookback that falls silent changes nothing: GPS was wrong when it spoke last. The pilot gets a line each 30 s, and may
select the first set (RCx_OPTION 90) or another mode.
--]]

local PARAM_TABLE_KEY = 187
local NAMED_VALUE_FLOAT = 251
local NAME = "gps_doubt"
local FIRST_SET, SECOND_SET = 0, 1
local RTL_MODES = { [1] = 11, [2] = 6, [3] = 11 } -- by FWVersion:type(): Rover, Copter, Plane
local WARNING, NOTICE = 4, 5
local PERIOD_MS = 200
local SILENT_TICKS, SAID_TICKS = 50, 150 -- 10 s without a value, which come once a second; 30 s between two lines

assert(param:add_table(PARAM_TABLE_KEY, "LKG_", 3), "lookback_gps: no room for parameters")
assert(param:add_param(PARAM_TABLE_KEY, 1, "ACTION", 0), "lookback_gps: LKG_ACTION")
assert(param:add_param(PARAM_TABLE_KEY, 2, "COUNT", 3), "lookback_gps: LKG_COUNT")
assert(param:add_param(PARAM_TABLE_KEY, 3, "COMPID", 191), "lookback_gps: LKG_COMPID")

-- Both numbers alike: their order differs between versions of the documentation.
mavlink:init(10, 10)
mavlink:register_rx_msgid(NAMED_VALUE_FLOAT)

local system_id = param:get("MAV_SYSID") or param:get("SYSID_THISMAV")
local wrong, right = 0, 0
local acted = false
local tick, heard_tick, said_tick = 0, 0, -SAID_TICKS

-- The value in a message, or nil if it is another one. The string is ArduPilot's mavlink_message_t, whose header grew
-- when system IDs of 32 bits came; a payload is followed by zeros where the sender cut them off.
local function doubt_in(message)
  local system, component, _, _, value, name =
    string.unpack(#message >= 299 and "<I4BI3I4fc10" or "<BBI3I4fc10", message, 8)
  if system ~= system_id or component ~= param:get("LKG_COMPID") then
    return nil
  end
  if string.match(name, "^[^\0]*") ~= NAME then
    return nil
  end
  return value
end

local function act()
  local action = param:get("LKG_ACTION")
  acted = true
  if action == 1 or action == 3 then
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
    ahrs:set_posvelyaw_source_set(FIRST_SET)
    gcs:send_text(NOTICE, "GPS consistent: source set 1")
  end
end

local function warn_if_silent()
  if acted and tick - heard_tick > SILENT_TICKS and tick - said_tick > SAID_TICKS then
    said_tick = tick
    gcs:send_text(WARNING, "Lookback is silent, GPS was wrong")
  end
end

local function update()
  tick = tick + 1
  local message = mavlink:receive_chan()
  while message do
    local doubt = doubt_in(message)
    if doubt then
      heard_tick = tick
      wrong = doubt >= 1 and wrong + 1 or 0
      right = (doubt >= 0 and doubt <= 0.2) and right + 1 or 0
    end
    message = mavlink:receive_chan()
  end
  local count = param:get("LKG_COUNT")
  if not acted and wrong >= count then
    act()
  elseif acted and right >= count then
    go_back()
  end
  warn_if_silent()
  return update, PERIOD_MS
end

return update()
