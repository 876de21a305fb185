-- Home on one switch, for ArduPilot 4.5 on: asks Lookback to upload the way home as a mission (docs/home.md).
--
-- Copy this file to APM/scripts on the autopilot's SD card, set SCR_ENABLE 1, reboot, and set:
--   LKH_ENABLE 1      run this script; 0 (default): it does nothing
--   LKH_FUNC   300    auxiliary function of the switch: RCx_OPTION 300 (Scripting1) to 307
--   LKH_MODE   -1     mode to change to once the mission is verified; -1 (default): none. AUTO is 10 on Rover, 3 on Copter
--   LKH_COMP   191    MAVLink component ID of Lookback ([telemetry] component_id)
--   LKH_ROUTE  0      number of the route in [home] routes; 0 (default) is the way home
--
-- Switch to high: request the mission. Switch to low before the mode changes: it does not. The script never arms.
-- Without valid input of the receiver, or after a failsafe, it changes no mode: FS_THR_ENABLE must be 1 on Rover.

local SEVERITY = { ERROR = 3, WARNING = 4, INFO = 6 }
local HEARTBEAT, COMMAND_LONG, COMMAND_ACK = 0, 76, 77
local MAV_CMD_USER_5, LOOK = 31014, 5665 -- LOOK: parameter 2, without which the command means something else
local ACCEPTED, NOT_NOW, IN_PROGRESS = 0, 1, 5
local RESULTS = { [1] = "not now", [2] = "denied", [3] = "unsupported", [4] = "failed" }
local LOW, HIGH = 0, 2
local PERIOD_MS = 100
local REPEAT_TICKS, REPETITIONS = 30, 5 -- a command without an answer, or answered "not now", every 3 s
local LONGEST_TICKS = 1800              -- from the first command to the mission
local SILENT_TICKS = 50                 -- without a heartbeat of Lookback
local MODE_TICKS = 50                   -- from the announcement of a change of mode to the change, 5 s
local SETTLE_TICKS = 10                 -- until the switch is read again after a loss; ArduPilot debounces it for 0.2 s
local MESSAGES_PER_TICK = 20
local LONG_MESSAGE = 299                -- bytes of a received message with system IDs of 32 bits, in later versions

local TABLE_KEY = 141
assert(param:add_table(TABLE_KEY, "LKH_", 5), "Lookback: parameter table " .. TABLE_KEY .. " is in use")
assert(param:add_param(TABLE_KEY, 1, "ENABLE", 0), "Lookback: no parameter LKH_ENABLE")
assert(param:add_param(TABLE_KEY, 2, "FUNC", 300), "Lookback: no parameter LKH_FUNC")
assert(param:add_param(TABLE_KEY, 3, "MODE", -1), "Lookback: no parameter LKH_MODE")
assert(param:add_param(TABLE_KEY, 4, "COMP", 191), "Lookback: no parameter LKH_COMP")
assert(param:add_param(TABLE_KEY, 5, "ROUTE", 0), "Lookback: no parameter LKH_ROUTE")

-- Both numbers alike: the order of the arguments differs between versions of the documentation.
mavlink:init(10, 10)
mavlink:register_rx_msgid(HEARTBEAT)
mavlink:register_rx_msgid(COMMAND_ACK)

local system_id = param:get("MAV_SYSID") or param:get("SYSID_THISMAV")
local tick = 0
local channel, heard_tick -- of Lookback's heartbeats
local position            -- of the switch; nil where it is not known
local lost_tick = 0       -- when the receiver had no valid input last
local request             -- { first, last: ticks; sent: commands; answered: whether the upload is under way; from: the mode
                          --   at that time; again: after "not now"; items: of the mission, once it is there; ready: when that was }

local function say(severity, text)
    gcs:send_text(severity, "Home: " .. text)
end

local function send_command()
    local fields = string.pack("<fffffffI2BBB", 1, LOOK, param:get("LKH_ROUTE"), 0, 0, 0, 0, MAV_CMD_USER_5,
        system_id, param:get("LKH_COMP"), request.sent)
    request.sent, request.last = request.sent + 1, tick
    mavlink:send_chan(channel, COMMAND_LONG, fields)
end

local function begin_request()
    if not channel or tick - heard_tick > SILENT_TICKS then
        say(SEVERITY.ERROR, "Lookback is not connected")
        return
    end
    request = { first = tick, last = tick, sent = 0, answered = false, again = 0, from = vehicle:get_mode() }
    say(SEVERITY.INFO, "mission requested")
    send_command()
end

local function end_request(severity, text)
    request = nil
    say(severity, text)
end

-- What speaks against a change of mode, nil if nothing does.
local function objection()
    if mission:num_commands() ~= request.items then
        return SEVERITY.ERROR, "the mission has changed"
    elseif not arming:is_armed() then
        return SEVERITY.WARNING, "the mission is ready, not armed"
    elseif position ~= HIGH then
        return SEVERITY.WARNING, "the mission is ready, switch is not high"
    elseif vehicle:get_mode() ~= request.from then
        return SEVERITY.WARNING, "the mission is ready, mode has changed"
    elseif battery:has_failsafed() or vehicle:has_ekf_failsafed() then
        return SEVERITY.WARNING, "the mission is ready, failsafe"
    end
end

-- The mission is there. Changes the mode after MODE_TICKS where the parameter asks for it, and all else permits it.
local function mission_ready()
    local mode = param:get("LKH_MODE")
    if mission:num_commands() == request.items and (mode == nil or mode < 0) then
        return end_request(SEVERITY.INFO, "the mission is ready")
    end
    local severity, text = objection()
    if severity then
        return end_request(severity, text)
    end
    if not request.ready then
        request.ready = tick
        local seconds = MODE_TICKS * PERIOD_MS // 1000
        say(SEVERITY.WARNING, string.format("mode %d in %d s, switch low cancels", mode // 1, seconds))
    elseif tick - request.ready >= MODE_TICKS then
        if mission:set_current_cmd(1) and vehicle:set_mode(math.floor(mode)) then
            end_request(SEVERITY.INFO, "on the way")
        else
            end_request(SEVERITY.ERROR, "the mode was refused")
        end
    end
end

local function acknowledged(message, payload)
    local command, result, _, items, to_system, to_component = string.unpack("<I2BBi4BB", message, payload)
    if not request or request.items or command ~= MAV_CMD_USER_5 or to_system ~= system_id or to_component ~= 1 then
        return
    end
    if result == IN_PROGRESS then
        request.answered = true
    elseif result == ACCEPTED then
        request.items = items
    elseif result == NOT_NOW and position == HIGH and request.again < REPETITIONS then
        -- A new command: a repetition gets the same answer again. With 0 for a position that is known in a moment.
        request.again, request.sent, request.last, request.answered = request.again + 1, 0, tick, false
    else
        end_request(SEVERITY.ERROR, "no mission, " .. (RESULTS[result] or ("result " .. result)))
    end
end

local function read_messages()
    for _ = 1, MESSAGES_PER_TICK do
        local message, from = mavlink:receive_chan()
        if not message then
            return
        end
        -- The string is ArduPilot's mavlink_message_t.
        local format = #message >= LONG_MESSAGE and "<I4BI3" or "<BBI3"
        local sender_system, sender_component, kind, payload = string.unpack(format, message, 8)
        if sender_system == system_id and sender_component == param:get("LKH_COMP") then
            if kind == HEARTBEAT then
                channel, heard_tick = from, tick
            elseif kind == COMMAND_ACK then
                acknowledged(message, payload)
            end
        end
    end
end

local function read_switch()
    if not rc:has_valid_input() then
        lost_tick = tick
    end
    local now = rc:get_aux_cached(param:get("LKH_FUNC"))
    -- While the receiver is lost ArduPilot keeps the last position, and for a moment afterwards.
    if now == nil or tick - lost_tick < SETTLE_TICKS then
        position = nil
        return
    end
    -- The first position is no movement: a switch that is high at boot, or after a loss, requests nothing.
    local rose = position ~= nil and position ~= HIGH and now == HIGH
    position = now
    if rose and not request then
        begin_request()
    end
end

local function repeat_command()
    if not request or request.items or tick - request.last < REPEAT_TICKS then
        return
    end
    if tick - request.first > LONGEST_TICKS or (not request.answered and request.sent > REPETITIONS) then
        end_request(SEVERITY.ERROR, "no answer from Lookback")
    else
        send_command()
    end
end

local function update()
    tick = tick + 1
    if param:get("LKH_ENABLE") ~= 1 or not system_id then
        position, request = nil, nil
        return
    end
    read_messages()
    read_switch()
    repeat_command()
    if request and request.items then
        mission_ready()
    end
end

-- An error in one call ends the request, not the script.
local function protected()
    local fine, why = pcall(update)
    if not fine then
        request = nil
        say(SEVERITY.ERROR, tostring(why))
        return protected, 1000
    end
    return protected, PERIOD_MS
end

return protected()
